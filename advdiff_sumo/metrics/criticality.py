"""Clearance and time to collision between the target's box and those of others, in the plane.

Both are evaluated at instants, from the start to the last one before the target's first collision. See also
``following`` (same lane) and ``encroachment`` (crossing paths).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.boxes import axis_gaps, corners, distance
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.kinematics import velocities

#: Later contacts do not count.
TTC_HORIZON_S = 10.0
#: Rates below this are 0.
_LEAST_RATE_MPS = 1e-12
#: Values that differ by at most this are equal, so that rounding does not decide which of them is the earliest.
_SAME = 1e-6


@dataclass(frozen=True)
class Extreme:
    """The most critical value of a measure.

    Attributes:
        value: the value, in the unit of the measure.
        row: the other agent.
        time_s: time since the episode's start.
    """

    value: float
    row: int
    time_s: float


def smallest_value(values: FloatArray, tracks: Tracks) -> Extreme | None:
    """Return the smallest finite of *values* (A, T); of equal ones the earliest, then the lowest row."""
    if not np.isfinite(values).any():
        return None
    by_time = np.where(np.isfinite(values), values, np.inf).T
    least = float(by_time.min())
    step, row = np.unravel_index(int(np.argmax(by_time <= least + _SAME)), by_time.shape)
    return Extreme(least, int(row), tracks.t0_s + float(step) * tracks.dt_s)


def time_to_collision(tracks: Tracks, target: int) -> FloatArray:
    """Return (A, T) seconds until the boxes of each agent and the target meet at constant velocity and heading.

    Velocities come from positions. inf if they do not meet within ``TTC_HORIZON_S``, 0 if they overlap already, NaN
    where one is absent and for the target itself. The result is exact: two boxes that only translate overlap while they
    overlap along each of the four separating axes, and each axis gives one interval of time. Hayward (1972), "Near-miss
    determination through use of a scale of danger", for boxes instead of points.
    """
    velocity = velocities(tracks)
    half = np.broadcast_to(0.5 * tracks.size_m[:, None], tracks.xy_m.shape)
    yaw = np.broadcast_to(tracks.yaw_rad[target], tracks.yaw_rad.shape)
    offset = tracks.xy_m - tracks.xy_m[target]
    gaps, along, axes = axis_gaps(
        offset, yaw, np.broadcast_to(half[target], half.shape), tracks.yaw_rad, half
    )
    rate = np.einsum("atic,atc->ati", axes, velocity - velocity[target])
    seconds = meeting_s(gaps, along, rate)
    absent = np.isnan(offset).any(-1)
    absent[target] = True
    return np.where(absent, np.nan, seconds)


def meeting_s(gaps: FloatArray, along: FloatArray, rate: FloatArray) -> FloatArray:
    """Return (…,) when two boxes meet; inf for never.

    Args:
        gaps: (…, 4) gaps along the four separating axes.
        along: (…, 4) offsets along them.
        rate: (…, 4) rates of change of the offsets.
    """
    enter, leave = _overlap_times(np.abs(along) - gaps, along, rate)
    start, end = enter.max(-1), leave.min(-1)
    meets = (start < end) & (end > 0.0) & (start <= TTC_HORIZON_S)
    return np.where(meets, np.maximum(start, 0.0), np.inf)


def _overlap_times(reach: FloatArray, along: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return when |along + rate t| < reach begins and ends; (−inf, inf) for always, (inf, −inf) for never."""
    constant = np.abs(rate) < _LEAST_RATE_MPS
    divisor = np.where(constant, 1.0, rate)
    at_minus_reach, at_reach = (-reach - along) / divisor, (reach - along) / divisor
    constant_begin = np.where(np.abs(along) < reach, -np.inf, np.inf)
    return (
        np.where(constant, constant_begin, np.minimum(at_minus_reach, at_reach)),
        np.where(constant, -constant_begin, np.maximum(at_minus_reach, at_reach)),
    )


def clearances(tracks: Tracks, target: int) -> FloatArray:
    """Return (A, T) distances between each agent's box and the target's, where they may be the smallest.

    inf where a distance cannot be the smallest of its instant, because the circles around the boxes are farther apart
    than the nearest centre is. NaN where an agent is absent and for the target itself; 0 if the boxes overlap.
    """
    offset = tracks.xy_m - tracks.xy_m[target]
    centre_distance = np.hypot(offset[..., 0], offset[..., 1])
    centre_distance[target] = np.nan
    or_inf = np.where(np.isnan(centre_distance), np.inf, centre_distance)
    radius = 0.5 * np.hypot(tracks.size_m[:, 0], tracks.size_m[:, 1])
    near = np.isfinite(or_inf) & (or_inf - (radius + radius[target])[:, None] <= or_inf.min(axis=0))
    row, step = np.nonzero(near)
    boxes = corners(tracks.xy_m[row, step], tracks.yaw_rad[row, step], tracks.size_m[row])
    own_boxes = corners(tracks.xy_m[target, step], tracks.yaw_rad[target, step], tracks.size_m[target])
    result = np.where(np.isnan(centre_distance), np.nan, np.inf)
    result[row, step] = distance(boxes, own_boxes)
    return result
