"""Drives many vehicles at once along their lanes: pure pursuit with the bicycle model of ``core.bicycle``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.bicycle import step
from advdiff_sumo.core.frames import wrap_angle

_LOOK_AHEAD_S, _MIN_LOOK_AHEAD_M = 0.8, 4.0
_ACCEL_MPS2, _BRAKE_MPS2, _LATERAL_MPS2 = 1.5, 2.5, 2.0
_GRID_M, _REACH_M = 0.5, 160.0
"""Points to aim at are on a grid of arc lengths with this spacing, up to this arc length."""
_LOOK_AHEADS = np.array([[1.0], [2.0]])
"""Multiples of the look-ahead distance: the point to aim at, and where the bend of the lane is measured."""
_OFFSET_M = 1e6
"""Offset between the arc lengths of successive lines in a :class:`Row`; longer than any line."""


class Lines(NamedTuple):
    """Centre lines of V vehicles' lanes, concatenated; F segments in all.

    Attributes:
        xy_m: (F, 2) start points of the segments.
        tangent: (F, 2) unit vectors along them.
        yaw_rad: (F,) their headings.
        s_m: (F,) arc lengths of their start points.
        first: (V,) first segment of each line.
        last: (V,) last segment of each line.
        begin_m: (V,) arc length of each vehicle now.
        limit_mps: (V,) speed limit.
    """

    xy_m: FloatArray
    tangent: FloatArray
    yaw_rad: FloatArray
    s_m: FloatArray
    first: IntArray
    last: IntArray
    begin_m: FloatArray
    limit_mps: FloatArray


class Row(NamedTuple):
    """Arc lengths of all lines as one ascending array, in which segments are found by bisection.

    Attributes:
        s_m: (F,) arc lengths of the segments, plus the offset of their line.
        begin_m: (V,) offset of each line.
    """

    s_m: FloatArray
    begin_m: FloatArray


def in_a_row(lines: Lines) -> Row:
    """Return the arc lengths of *lines* as one ascending array."""
    begin = _OFFSET_M * np.arange(len(lines.first), dtype=np.float64)
    return Row(lines.s_m + np.repeat(begin, lines.last - lines.first + 1), begin)


def segments(lines: Lines, row: Row, s_m: FloatArray) -> IntArray:
    """Return the segments (…, V) of the lines at arc lengths *s_m* (…, V); beyond its ends, a line's end segments."""
    segment = row.s_m.searchsorted(np.maximum(s_m, 0.0) + row.begin_m, side="right") - 1
    return np.minimum(segment, lines.last)


def aim(lines: Lines, row: Row, s_m: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the accelerations and curvatures (V,) that follow the centre lines at their speed limits.

    Args:
        lines: centre lines of the vehicles.
        row: result of :func:`in_a_row`.
        s_m: (V,) distances driven so far.
        states: (V, 4) x, y, yaw, speed.
    """
    yaw, speed = states[:, 2], states[:, 3]
    look_ahead = np.maximum(_MIN_LOOK_AHEAD_M, _LOOK_AHEAD_S * speed)
    aim_s = lines.begin_m + _on_grid(s_m + _LOOK_AHEADS * look_ahead)
    near, far = segments(lines, row, aim_s)
    along = aim_s[0] - lines.s_m[near]
    x, y = (lines.xy_m[near] + along[:, None] * lines.tangent[near] - states[:, :2]).T
    curvature = 2.0 * np.sin(np.arctan2(y, x) - yaw) / np.maximum(np.hypot(x, y), 1.0)
    lane_curvature = np.abs(wrap_angle(lines.yaw_rad[far] - yaw)) / (2.0 * look_ahead)
    desired_mps = np.minimum(lines.limit_mps, np.sqrt(_LATERAL_MPS2 / np.maximum(lane_curvature, 1e-3)))
    return _clipped(desired_mps - speed, -_BRAKE_MPS2, _ACCEL_MPS2), curvature


def pursue(
    lines: Lines, states: FloatArray, max_curvature: FloatArray, lateral_mps2: float, dt_s: float, steps: int
) -> FloatArray:
    """Return the states (V, T, 4) after each of T steps.

    Args:
        lines: centre lines of the vehicles.
        states: (V, 4) x, y, yaw, speed.
        max_curvature: (V,) largest curvatures by steering.
        lateral_mps2: largest lateral acceleration.
        dt_s: duration of a step.
        steps: number of steps T.
    """
    driven, s = np.empty((len(states), steps, 4)), np.zeros(len(states))
    row = in_a_row(lines)
    for t in range(steps):
        accel, curvature = aim(lines, row, s, states)
        bound = np.minimum(max_curvature, lateral_mps2 / np.maximum(states[:, 3], 0.1) ** 2)
        s = s + states[:, 3] * dt_s
        curvature = _clipped(curvature, -bound, bound)
        moved = step(states[:, :2], states[:, 2], states[:, 3], accel, curvature, dt_s)
        driven[:, t, :2], driven[:, t, 2], driven[:, t, 3] = moved
        states = driven[:, t]
    return driven


def _on_grid(s_m: FloatArray) -> FloatArray:
    """Return *s_m* rounded to the grid and bounded by its end."""
    return _GRID_M * np.minimum(np.rint(s_m / _GRID_M), _REACH_M / _GRID_M - 1.0)


def _clipped(values: FloatArray, low: FloatArray | float, high: FloatArray | float) -> FloatArray:
    """Return *values* (V,) clipped; twice as fast as ``np.clip``."""
    return np.minimum(np.maximum(values, low), high)
