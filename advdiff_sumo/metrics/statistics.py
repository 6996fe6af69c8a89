"""Statistics of episodes: rates with their intervals, paired tests, and the bootstrap over seed scenes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtr, bdtrc, ndtri, rel_entr  # scipy.stats would take a second of every command

from advdiff_sumo.core.arrays import FloatArray

#: Percentiles between which an interval of the bootstrap lies: 95 %.
TAILS = (2.5, 97.5)
_AT_ONCE = 250
_NO_WIDTH = 1e-9  # what rounding leaves of it


@dataclass(frozen=True)
class Rate:
    """How often something happened, with its 95 % Wilson interval.

    Attributes:
        count: how often.
        total: out of how many.
        low: lower end; None without a sample.
        high: upper end; None without a sample.
    """

    count: int
    total: int
    low: float | None
    high: float | None

    @staticmethod
    def of(count: int, total: int) -> Rate:
        """Return the rate of *count* in *total*."""
        low, high = wilson(count, total) if total else (None, None)
        return Rate(count, total, low, high)

    @staticmethod
    def of_flags(flags: Sequence[bool]) -> Rate:
        """Return the rate of those of *flags* that are set."""
        return Rate.of(sum(flags), len(flags))

    @property
    def share(self) -> float | None:
        """The observed share; None without a sample."""
        return self.count / self.total if self.total else None


def wilson(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of *count* successes in *total* trials (doi 10.2307/2276774).

    Raises:
        ValueError: *total* is 0 or *count* is not in [0, total].
    """
    if not 0 <= count <= total or total == 0:
        raise ValueError(f"{count} of {total} is no rate")
    z, share = float(ndtri(0.975)), count / total
    middle = (share + 0.5 * z**2 / total) / (1.0 + z**2 / total)
    half = z * (share * (1.0 - share) / total + 0.25 * (z / total) ** 2) ** 0.5 / (1.0 + z**2 / total)
    return max(middle - half, 0.0) if count else 0.0, min(middle + half, 1.0) if count < total else 1.0


def spread(low: float, high: float, trials: int) -> tuple[float, float]:
    """Return the bootstrap's interval of a paired difference of rates, or a wider one where it has no width.

    Pairs that all differ alike, such as those without a discordant one, show no spread when they are drawn again. That
    none of so many is otherwise says that up to Wilson's bound for none may be, and the difference lies within that.

    Args:
        low: lower end.
        high: upper end.
        trials: pairs, or the trials of the rate that has fewer.
    """
    if high - low > _NO_WIDTH:
        return low, high
    most = wilson(0, trials)[1]
    return max(low - most, -1.0), min(high + most, 1.0)


def mcnemar(only_a: int, only_b: int) -> float:
    """Return the two-sided p of the exact McNemar test (doi:10.1007/BF02295996); 1 without discordant pairs."""
    return min(1.0, 2.0 * float(bdtr(min(only_a, only_b), only_a + only_b, 0.5)))


def mcnemar_more(only_a: int, only_b: int) -> float:
    """Return the one-sided p of the exact McNemar test that a happens more often than b; 1 without discordant pairs."""
    return float(bdtrc(only_a - 1, only_a + only_b, 0.5))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return *p_values* adjusted for each other by Holm's step-down method (doi:10.2307/4615733), in their order."""
    order = sorted(range(len(p_values)), key=lambda k: p_values[k])
    adjusted, largest = [1.0] * len(p_values), 0.0
    for rank, k in enumerate(order):
        largest = max(largest, min((len(p_values) - rank) * p_values[k], 1.0))
        adjusted[k] = largest
    return adjusted


def bootstrap_counts(scenes: int, seed: int, resamples: int) -> Iterator[FloatArray]:
    """Yield (R, S) how often each of S scenes is drawn in each sample of the bootstrap, some samples at a time."""
    rng = np.random.default_rng(seed)
    shares = np.full(scenes, 1.0 / scenes)
    for begun in range(0, resamples, _AT_ONCE):
        yield rng.multinomial(scenes, shares, size=min(_AT_ONCE, resamples - begun)).astype(np.float64)


def jensen_shannon(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return Jensen-Shannon divergences (…) of histograms (…, K), 0 (alike) … 1 (nothing in common), base 2.

    NaN where one is empty. ``scipy.spatial.distance.jensenshannon`` gives the square root, which rounding makes NaN for
    histograms that hardly differ.
    """
    p_total, q_total = p.sum(-1, keepdims=True), q.sum(-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        p, q = p / p_total, q / q_total
    middle = 0.5 * (p + q)
    return np.asarray(0.5 * (rel_entr(p, middle) + rel_entr(q, middle)).sum(-1) / np.log(2.0))
