"""Pure pursuit of lanes through the bicycle model of ``core.bicycle``, of many vehicles at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.bicycle import step
from advdiff_sumo.core.frames import wrap_angle

_LOOK_AHEAD_S, _MIN_LOOK_AHEAD_M = 0.8, 4.0
_ACCEL_MPS2, _BRAKE_MPS2, _LATERAL_MPS2 = 1.5, 2.5, 2.0
_EVERY_M, _REACH_M = 0.5, 160.0
_LOOKS = np.array([[1.0], [2.0]])
"""What is aimed at is one look ahead; how the lane bends, two."""
_APART_M = 1e6
"""Farther than any line is long: lines one after the other are one ascending row of numbers with this between."""


class Lines(NamedTuple):
    """Centre lines of V vehicles' lanes, one after the other; F segments in all.

    Attributes:
        xy_m: (F, 2) beginnings of the segments.
        tangent: (F, 2) unit vectors along them.
        yaw_rad: (F,) headings.
        s_m: (F,) arc lengths where they begin.
        first: (V,) segment that each line begins with.
        last: (V,) and ends with.
        begin_m: (V,) arc length of each vehicle.
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
    """Lines of V vehicles as one ascending row of arc lengths.

    Attributes:
        s_m: (F,) where segments begin, each line's far beyond those of the one before.
        begin_m: (V,) where lines begin.
    """

    s_m: FloatArray
    begin_m: FloatArray


def in_a_row(lines: Lines) -> Row:
    """Return *lines* as one row."""
    begin = _APART_M * np.arange(len(lines.first), dtype=np.float64)
    return Row(lines.s_m + np.repeat(begin, lines.last - lines.first + 1), begin)


def segments(lines: Lines, row: Row, s_m: FloatArray) -> IntArray:
    """Return the segments (…, V) of all lines at arc lengths *s_m* (…, V); the end ones go on."""
    segment = row.s_m.searchsorted(np.maximum(s_m, 0.0) + row.begin_m, side="right") - 1
    return np.minimum(segment, lines.last)


def aim(lines: Lines, row: Row, s_m: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return accelerations and curvatures (V,) towards the lanes' centres at their limits.

    Args:
        lines: of all vehicles.
        row: of :func:`in_a_row`.
        s_m: (V,) how far they have driven.
        states: (V, 4) x, y, yaw, speed.
    """
    yaw, speed = states[:, 2], states[:, 3]
    look = np.maximum(_MIN_LOOK_AHEAD_M, _LOOK_AHEAD_S * speed)
    ahead = lines.begin_m + _snapped(s_m + _LOOKS * look)
    near, far = segments(lines, row, ahead)
    along = ahead[0] - lines.s_m[near]
    x, y = (lines.xy_m[near] + along[:, None] * lines.tangent[near] - states[:, :2]).T
    bend = 2.0 * np.sin(np.arctan2(y, x) - yaw) / np.maximum(np.hypot(x, y), 1.0)
    turn = np.abs(wrap_angle(lines.yaw_rad[far] - yaw)) / (2.0 * look)
    wanted = np.minimum(lines.limit_mps, np.sqrt(_LATERAL_MPS2 / np.maximum(turn, 1e-3)))
    return _within(wanted - speed, -_BRAKE_MPS2, _ACCEL_MPS2), bend


def pursue(
    lines: Lines, states: FloatArray, bends: FloatArray, lateral_mps2: float, small_s: float, steps: int
) -> FloatArray:
    """Return the states (V, T, 4) after each of T steps.

    Args:
        lines: of the vehicles.
        states: (V, 4) x, y, yaw, speed.
        bends: (V,) largest curvatures by steering.
        lateral_mps2: largest lateral acceleration.
        small_s: duration of a step.
        steps: T.
    """
    driven, s = np.empty((len(states), steps, 4)), np.zeros(len(states))
    row = in_a_row(lines)
    for t in range(steps):
        accel, bend = aim(lines, row, s, states)
        bound = np.minimum(bends, lateral_mps2 / np.maximum(states[:, 3], 0.1) ** 2)
        s = s + states[:, 3] * small_s
        moved = step(states[:, :2], states[:, 2], states[:, 3], accel, _within(bend, -bound, bound), small_s)
        driven[:, t, :2], driven[:, t, 2], driven[:, t, 3] = moved
        states = driven[:, t]
    return driven


def _snapped(s_m: FloatArray) -> FloatArray:
    """Return *s_m* on a grid, within reach."""
    return _EVERY_M * np.minimum(np.rint(s_m / _EVERY_M), _REACH_M / _EVERY_M - 1.0)


def _within(values: FloatArray, low: FloatArray | float, high: FloatArray | float) -> FloatArray:
    """Return *values* (V,) clipped, in half of the time that ``np.clip`` takes."""
    return np.minimum(np.maximum(values, low), high)
