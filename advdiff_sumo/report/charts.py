"""Makes small charts over time as SVG path data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import MaxNLocator

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.report.series import Series

WIDTH, HEIGHT = 340, 130
_LEFT, _RIGHT, _TOP, _BOTTOM = 34, 12, 8, 20
_MOST_POINTS = 400
_TTC_TOP_S = 10.0


@dataclass(frozen=True)
class Curve:
    """One line of a chart: its vehicle ("target", "attacker", "reference") and its path."""

    role: str
    path: str


@dataclass(frozen=True)
class Chart:
    """One chart; positions in its own pixels of ``WIDTH`` × ``HEIGHT``.

    Attributes:
        title: quantity and unit.
        summary: description in words, for readers who cannot see the chart.
        curves: lines; empty if there is nothing to show.
        x_ticks: (position, text) on the time axis.
        y_ticks: (position, text).
        contact_x: position of the contact, or None.
        plot: left, top, right and bottom of the plotting area.
    """

    title: str
    summary: str
    curves: tuple[Curve, ...]
    x_ticks: tuple[tuple[str, str], ...]
    y_ticks: tuple[tuple[str, str], ...]
    contact_x: str | None
    plot: tuple[int, int, int, int] = (_LEFT, _TOP, WIDTH - _RIGHT, HEIGHT - _BOTTOM)


def charts_of(series: Series, contact_s: float | None) -> tuple[Chart, ...]:
    """Return the charts of one episode: speed, acceleration, jerk, nearest gap, time to collision.

    An episode of fewer than two instants has none.
    """
    if len(series.times_s) < 2:
        return ()
    speeds = {"attacker": series.attacker_mps, "reference": series.reference_mps, "target": series.speed_mps}
    times = series.times_s
    accelerations = {"reference": series.reference_accel_mps2, "target": series.accel_mps2}
    jerk = {"target": series.jerk_mps3}
    return (
        chart("Speed", "m/s", times, speeds, contact_s, least=(0.0, 1.0)),
        chart("Acceleration", "m/s²", times, accelerations, contact_s, least=(-1.0, 1.0)),
        chart("Jerk", "m/s³", times, jerk, contact_s, least=(-1.0, 1.0)),
        chart("Gap to the nearest", "m", times, {"target": series.gap_m}, contact_s, least=(0.0, 1.0)),
        chart("Time to collision", "s", times, {"target": series.ttc_s}, contact_s, least=(0.0, _TTC_TOP_S)),
    )


def chart(
    title: str,
    unit: str,
    times_s: FloatArray,
    curves: dict[str, FloatArray],
    contact_s: float | None,
    least: tuple[float, float],
) -> Chart:
    """Return one chart.

    Args:
        title: name of the quantity.
        unit: of the values.
        times_s: (T,) instants, T ≥ 1.
        curves: role → (T,) values; NaN leaves a gap.
        contact_s: time of the contact, which is marked by a line, or None.
        least: range of values that is always shown.
    """
    shown_curves = {role: values for role, values in curves.items() if np.isfinite(values).any()}
    all_values = np.concatenate([*shown_curves.values(), np.array(least)])
    low, high = float(np.nanmin(all_values)), float(np.nanmax(all_values))
    y_ticks = MaxNLocator(4).tick_values(low, high)
    bottom, top = min(low, float(y_ticks[0])), max(high, float(y_ticks[-1]))
    end_s = max(float(times_s[-1]), float(times_s[0]) + 1e-3)
    x_ticks = [t for t in MaxNLocator(6).tick_values(float(times_s[0]), end_s) if times_s[0] <= t <= end_s]

    def x_of(t: FloatArray | float) -> FloatArray:
        share = (np.asarray(t, dtype=np.float64) - times_s[0]) / (end_s - times_s[0])
        return np.asarray(_LEFT + share * (WIDTH - _LEFT - _RIGHT))

    def y_of(value: FloatArray | float) -> FloatArray:
        share = (np.asarray(value, dtype=np.float64) - bottom) / (top - bottom)
        return np.asarray(HEIGHT - _BOTTOM - share * (HEIGHT - _TOP - _BOTTOM))

    return Chart(
        title=f"{title} ({unit})",
        summary=_summary(title, unit, times_s, shown_curves),
        curves=tuple(Curve(role, _path(x_of(times_s), y_of(v))) for role, v in shown_curves.items()),
        x_ticks=tuple((f"{float(x_of(t)):.1f}", f"{t:g}") for t in x_ticks),
        y_ticks=tuple((f"{float(y_of(v)):.1f}", f"{v:g}".replace("-", "−")) for v in y_ticks),
        contact_x=None if contact_s is None else f"{float(x_of(contact_s)):.1f}",
    )


def _path(x: FloatArray, y: FloatArray) -> str:
    """Return path data with a gap wherever *y* is NaN; of long series every n-th point."""
    every = -(-len(x) // _MOST_POINTS)
    data: list[str] = []
    pen_up = True
    for k in [*range(0, len(x) - 1, every), len(x) - 1]:
        if np.isfinite(y[k]):
            data.append(f"{'M' if pen_up else 'L'}{x[k]:.1f} {y[k]:.1f}")
        pen_up = not np.isfinite(y[k])
    return "".join(data)


def _summary(title: str, unit: str, times_s: FloatArray, shown_curves: dict[str, FloatArray]) -> str:
    if not shown_curves:
        return f"{title}: nothing to show"
    return "; ".join(_one_summary(title, unit, times_s, role, v) for role, v in shown_curves.items())


def _one_summary(title: str, unit: str, times_s: FloatArray, role: str, values: FloatArray) -> str:
    low, high = int(np.nanargmin(values)), int(np.nanargmax(values))
    return (
        f"{title} of the {role}: least {values[low]:.1f} {unit} at {times_s[low]:.1f} s, "
        f"greatest {values[high]:.1f} {unit} at {times_s[high]:.1f} s"
    )
