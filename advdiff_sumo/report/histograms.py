"""Makes histograms of traffic with and without attack, as SVG path data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import MaxNLocator

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.report.sample_pictures import Samples
from advdiff_sumo.report.templates import number

WIDTH, HEIGHT = 340, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 40, 10, 8, 22
#: Distributions in one picture at most, so that it stays legible.
MOST_GROUPS = 6
_BINS = 30
_QUANTITIES = {
    "speed_mps": ("Speed of background vehicles", "m/s", 0.0, 40.0),
    "accel_mps2": ("Acceleration of background vehicles", "m/s²", -6.0, 6.0),
    "ttc_s": ("Time to collision of the target", "s", 0.0, 10.0),
}


@dataclass(frozen=True)
class Outline:
    """One distribution: number and label of its group, its path, and a summary in words."""

    group: int
    label: str
    path: str
    summary: str


@dataclass(frozen=True)
class Histogram:
    """One picture of ``WIDTH`` × ``HEIGHT`` pixels.

    Attributes:
        title: quantity and unit.
        outlines: the distributions, natural traffic first.
        x_ticks: (position, text).
        y_ticks: (position, text).
        plot: left, top, right and bottom of the plotting area.
    """

    title: str
    outlines: tuple[Outline, ...]
    x_ticks: tuple[tuple[str, str], ...]
    y_ticks: tuple[tuple[str, str], ...]
    plot: tuple[int, int, int, int] = (_LEFT, _TOP, WIDTH - _RIGHT, HEIGHT - _BOTTOM)


def histograms(groups: Mapping[str, Samples]) -> tuple[Histogram, ...]:
    """Return histograms of speed, acceleration and time to collision of the first ``MOST_GROUPS`` *groups*."""
    first = dict(list(groups.items())[:MOST_GROUPS])
    return tuple(
        _histogram({label: getattr(s, key) for label, s in first.items()}, *_QUANTITIES[key])
        for key in _QUANTITIES
    )


def _histogram(values: Mapping[str, FloatArray], title: str, unit: str, low: float, high: float) -> Histogram:
    """Return one histogram; values below *low* or above *high* count in the outermost bins."""
    edges = np.linspace(low, high, _BINS + 1)
    shares = {label: _shares(v, edges) for label, v in values.items() if len(v)}
    ticks = MaxNLocator(4).tick_values(
        0.0, 100.0 * max((float(s.max()) for s in shares.values()), default=0.1)
    )
    top = float(ticks[-1])

    def x_of(value: float) -> float:
        return _LEFT + (value - low) / (high - low) * (WIDTH - _LEFT - _RIGHT)

    def y_of(share: float) -> float:
        return HEIGHT - _BOTTOM - 100.0 * share / top * (HEIGHT - _TOP - _BOTTOM)

    def path(heights: FloatArray) -> str:
        steps = "".join(
            f"V{y_of(h):.1f}H{x_of(e):.1f}" for h, e in zip(heights.tolist(), edges[1:].tolist(), strict=True)
        )
        return f"M{x_of(low):.1f} {y_of(0.0):.1f}{steps}V{y_of(0.0):.1f}"

    outlines = [
        Outline(k, label, path(shares[label]), _summary(label, values[label], unit))
        for k, label in enumerate(values)
        if label in shares
    ]
    return Histogram(
        title=f"{title} ({unit})",
        outlines=tuple(outlines),
        x_ticks=tuple(
            (f"{x_of(t):.1f}", _tick_text(t))
            for t in MaxNLocator(6).tick_values(low, high)
            if low <= t <= high
        ),
        y_ticks=tuple((f"{y_of(t / 100.0):.1f}", f"{t:g} %") for t in ticks),
    )


def _shares(values: FloatArray, edges: FloatArray) -> FloatArray:
    counts = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0]
    return np.asarray(counts / counts.sum())


def _summary(label: str, values: FloatArray, unit: str) -> str:
    low, median, high = np.percentile(values, [5, 50, 95]).tolist()
    return f"{label}: median {number(median)} {unit}, 90 % between {number(low)} and {number(high)} {unit}"


def _tick_text(value: float) -> str:
    return f"{value:g}".replace("-", "−")
