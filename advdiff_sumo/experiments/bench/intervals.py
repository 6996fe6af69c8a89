"""Estimates figures with their intervals: Wilson for rates, bootstrap over seed scenes for the rest.

A sample has one entry for each seed scene, so any figure is a function of how often each scene is drawn. All values of
a scene, such as those of several vehicles or warm-ups, are drawn together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.metrics.statistics import (
    TAILS,
    bootstrap_counts,
    jensen_shannon,
    mcnemar,
    widened_interval,
    wilson,
)

RESAMPLES = 4000


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval.

    Attributes:
        value: the figure; None without a sample.
        low: lower end; None if it is undefined.
        high: upper end; None if it is undefined.
        n: size of the sample.
    """

    value: float | None = None
    low: float | None = None
    high: float | None = None
    n: int = 0


@dataclass(frozen=True)
class Difference:
    """One figure less another one, over the seed scenes that both have.

    Attributes:
        value: the difference; None if one of them is undefined.
        low: lower end of its 95 % bootstrap interval; for rates whose pairs all differ equally, see
            ``widened_interval``.
        high: upper end.
        p: exact McNemar test, two-sided (doi:10.1007/BF02295996); None for figures that are no rates of episodes.
        scenes: number of seed scenes that both have.
    """

    value: float | None = None
    low: float | None = None
    high: float | None = None
    p: float | None = None
    scenes: int = 0


class Sample(Protocol):
    """The data of a cell, for S seed scenes."""

    @property
    def scenes(self) -> tuple[str, ...]:
        """Keys of the scenes."""
        ...

    @property
    def n(self) -> int:
        """Size of the sample."""
        ...

    def at(self, times: FloatArray) -> FloatArray:
        """Return the figure (R,) if each scene is drawn *times* (R, S); NaN where it is undefined."""
        ...

    def rows(self, rows: IntArray) -> Sample:
        """Return the sample of the scenes at *rows*."""
        ...


@dataclass(frozen=True)
class Ratio:
    """A sum over scenes divided by another one: a mean, or a share.

    Attributes:
        scenes: keys.
        total: (S,) sums of values, or numbers of events.
        count: (S,) numbers of values, or of trials.
        rate: whether it is a share of trials, which gets Wilson's interval.
    """

    scenes: tuple[str, ...]
    total: FloatArray
    count: FloatArray
    rate: bool = False

    @property
    def n(self) -> int:
        """Number of values or trials."""
        return round(float(self.count.sum()))

    def at(self, times: FloatArray) -> FloatArray:
        """Return the figure for each draw."""
        total_count = times @ self.count
        return np.asarray(
            np.where(
                total_count > 0.0, times @ self.total / np.where(total_count > 0.0, total_count, 1.0), np.nan
            )
        )

    def rows(self, rows: IntArray) -> Ratio:
        """Return the sample of the scenes at *rows*."""
        return Ratio(
            tuple(self.scenes[k] for k in rows.tolist()), self.total[rows], self.count[rows], self.rate
        )

    @property
    def flags(self) -> FloatArray | None:
        """(S,) events of the scenes' single trials, 0 or 1; NaN for scenes without; None if a scene has several."""
        if not self.rate or (self.count > 1.0).any():
            return None
        return np.where(self.count > 0.0, self.total, np.nan)


@dataclass(frozen=True)
class Divergence:
    """Mean Jensen-Shannon divergence of several histograms from those of a reference, base 2.

    Attributes:
        scenes: keys.
        counts: histograms, each (S, K).
        reference: the reference's histograms in the same scenes, each (S, K).
    """

    scenes: tuple[str, ...]
    counts: tuple[FloatArray, ...]
    reference: tuple[FloatArray, ...] = field(default=())

    @property
    def n(self) -> int:
        """Number of values in the first histogram."""
        return round(float(self.counts[0].sum()))

    def at(self, times: FloatArray) -> FloatArray:
        """Return the divergence for each draw; the same scenes are drawn for the reference."""
        divergences = [
            jensen_shannon(times @ counts, times @ reference)
            for counts, reference in zip(self.counts, self.reference, strict=True)
        ]
        return np.asarray(np.mean(divergences, axis=0))

    def rows(self, rows: IntArray) -> Divergence:
        """Return the sample of the scenes at *rows*."""
        return Divergence(
            tuple(self.scenes[k] for k in rows.tolist()),
            tuple(counts[rows] for counts in self.counts),
            tuple(counts[rows] for counts in self.reference),
        )


def estimate(sample: Sample) -> Estimate:
    """Return the figure of *sample* with Wilson's interval for a rate, else the percentile bootstrap over scenes.

    Resampling increases a divergence on average; its percentiles are corrected by this bias.
    """
    if not sample.scenes or not sample.n:
        return Estimate()
    value = _point_estimate(sample)
    if np.isnan(value):
        return Estimate(n=sample.n)
    if isinstance(sample, Ratio) and sample.rate:
        return Estimate(value, *wilson(round(float(sample.total.sum())), sample.n), sample.n)
    resampled = sample.at(draws(len(sample.scenes)))
    lower_bound = 0.0 if isinstance(sample, Divergence) else -np.inf
    return Estimate(value, *_percentiles(_bias_corrected(sample, resampled, value), lower_bound), sample.n)


def difference(sample: Sample, other: Sample) -> Difference:
    """Return the figure of *sample* less that of *other*, over common scenes; the same ones are drawn for both."""
    a, b = aligned_samples(sample, other)
    if not a.scenes:
        return Difference()
    value = _point_estimate(a) - _point_estimate(b)
    if np.isnan(value):
        return Difference(scenes=len(a.scenes))
    times = draws(len(a.scenes))
    low, high = _percentiles(_bias_corrected(a, a.at(times) - b.at(times), value))
    if low is not None and high is not None and _is_rate(a) and _is_rate(b):
        low, high = widened_interval(low, high, min(a.n, b.n))
    return Difference(value, low, high, _mcnemar_of(a, b), len(a.scenes))


def aligned_samples(a: Sample, b: Sample) -> tuple[Sample, Sample]:
    """Return both samples restricted to their common scenes, in the order of the first."""
    row_of = {scene: row for row, scene in enumerate(b.scenes)}
    rows = np.array([k for k, scene in enumerate(a.scenes) if scene in row_of], dtype=np.int64)
    other_rows = np.array([row_of[a.scenes[k]] for k in rows.tolist()], dtype=np.int64)
    return a.rows(rows), b.rows(other_rows)


def draws(scenes: int) -> FloatArray:
    """Return how often each scene is drawn in each of the bootstrap's samples (R, S)."""
    return np.concatenate(list(bootstrap_counts(scenes, 0, RESAMPLES)))


def ratio(scenes: Sequence[str], total: Sequence[float], count: Sequence[float], rate: bool = False) -> Ratio:
    """Return a :class:`Ratio` of plain lists."""
    return Ratio(tuple(scenes), np.asarray(total, np.float64), np.asarray(count, np.float64), rate)


def _mcnemar_of(a: Sample, b: Sample) -> float | None:
    if not isinstance(a, Ratio) or not isinstance(b, Ratio):
        return None
    first, second = a.flags, b.flags
    if first is None or second is None:
        return None
    return mcnemar(
        int(((first == 1.0) & (second == 0.0)).sum()), int(((first == 0.0) & (second == 1.0)).sum())
    )


def _is_rate(sample: Sample) -> bool:
    return isinstance(sample, Ratio) and sample.rate


def _point_estimate(sample: Sample) -> float:
    return float(sample.at(np.ones((1, len(sample.scenes))))[0])


def _bias_corrected(sample: Sample, drawn: FloatArray, value: float) -> FloatArray:
    """Return the bootstrap's figures; for divergences and their differences shifted so that their mean is *value*."""
    return drawn - (np.nanmean(drawn) - value) if isinstance(sample, Divergence) else drawn


def _percentiles(values: FloatArray, lower_bound: float = -np.inf) -> tuple[float | None, float | None]:
    defined = values[~np.isnan(values)]
    if not len(defined):
        return None, None
    low, high = np.maximum(np.percentile(defined, TAILS), lower_bound)
    return float(low), float(high)
