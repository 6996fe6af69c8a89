"""Statistics over episodes: rates with intervals, paired tests, and the bootstrap over seed scenes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtr, bdtrc, ndtri, rel_entr  # scipy.stats would take a second of every command

from advdiff_sumo.core.arrays import FloatArray

#: Percentiles at the ends of a 95 % bootstrap interval.
TAILS = (2.5, 97.5)
#: Bootstrap samples that are drawn at once.
_BATCH = 250
#: An interval narrower than this has no width; the rest is rounding.
_NO_WIDTH = 1e-9


@dataclass(frozen=True)
class Rate:
    """The rate of an event, with its 95 % Wilson interval.

    Attributes:
        count: number of trials with the event.
        total: number of trials.
        low: lower end of the interval; None without trials.
        high: upper end of the interval; None without trials.
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
        """Return the rate of True in *flags*."""
        return Rate.of(sum(flags), len(flags))

    @property
    def share(self) -> float | None:
        """The observed share; None without trials."""
        return self.count / self.total if self.total else None


def wilson(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of *count* successes in *total* trials (doi 10.2307/2276774).

    Raises:
        ValueError: *total* is 0 or *count* is not in [0, total].
    """
    if not 0 <= count <= total or total == 0:
        raise ValueError(f"{count} of {total} is no rate")
    z, share = float(ndtri(0.975)), count / total
    centre = (share + 0.5 * z**2 / total) / (1.0 + z**2 / total)
    half = z * (share * (1.0 - share) / total + 0.25 * (z / total) ** 2) ** 0.5 / (1.0 + z**2 / total)
    return max(centre - half, 0.0) if count else 0.0, min(centre + half, 1.0) if count < total else 1.0


def widened_interval(low: float, high: float, trials: int) -> tuple[float, float]:
    """Return the bootstrap interval of a paired difference of rates, widened if it has no width.

    If all pairs have the same difference (for example, if none is discordant), resampling shows no spread. Since none
    of the *trials* differs, the true rate of differing ones is at most Wilson's upper bound for zero of *trials*. The
    interval is widened by this bound.

    Args:
        low: lower end.
        high: upper end.
        trials: number of pairs, or of trials of the rate that has fewer.
    """
    if high - low > _NO_WIDTH:
        return low, high
    bound = wilson(0, trials)[1]
    return max(low - bound, -1.0), min(high + bound, 1.0)


def mcnemar(only_a: int, only_b: int) -> float:
    """Return the two-sided p of the exact McNemar test (doi:10.1007/BF02295996); 1 without discordant pairs."""
    return min(1.0, 2.0 * float(bdtr(min(only_a, only_b), only_a + only_b, 0.5)))


def mcnemar_more(only_a: int, only_b: int) -> float:
    """Return the one-sided p of the exact McNemar test for a being more frequent than b; 1 without discordant pairs."""
    return float(bdtrc(only_a - 1, only_a + only_b, 0.5))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return *p_values*, in their order, adjusted by Holm's step-down method (doi:10.2307/4615733)."""
    order = sorted(range(len(p_values)), key=lambda k: p_values[k])
    adjusted, largest = [1.0] * len(p_values), 0.0
    for rank, k in enumerate(order):
        largest = max(largest, min((len(p_values) - rank) * p_values[k], 1.0))
        adjusted[k] = largest
    return adjusted


def bootstrap_counts(scenes: int, seed: int, resamples: int) -> Iterator[FloatArray]:
    """Yield batches (R, S) of bootstrap samples: how often each of S scenes is drawn in each of R samples."""
    rng = np.random.default_rng(seed)
    probabilities = np.full(scenes, 1.0 / scenes)
    for start in range(0, resamples, _BATCH):
        yield rng.multinomial(scenes, probabilities, size=min(_BATCH, resamples - start)).astype(np.float64)


def jensen_shannon(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return Jensen-Shannon divergences (…) of histograms (…, K), base 2: 0 for equal ones, 1 for disjoint ones.

    NaN if one is empty. ``scipy.spatial.distance.jensenshannon`` returns the square root, which rounding makes NaN for
    histograms that hardly differ.
    """
    p_total, q_total = p.sum(-1, keepdims=True), q.sum(-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        p, q = p / p_total, q / q_total
    middle = 0.5 * (p + q)
    return np.asarray(0.5 * (rel_entr(p, middle) + rel_entr(q, middle)).sum(-1) / np.log(2.0))
