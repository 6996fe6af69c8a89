"""Speed of a vehicle that meets nobody on its way: it slows in time for lower limits and for bends."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_DT_S, CHECK_TIMES_S, FINE_STEPS
from advdiff_sumo.traffic.manoeuvres.ways import Way

SPEEDING_UP_MPS2 = 0.5
"""Acceleration towards the limit."""
_SLOWING_MPS2, _MAX_SLOWING_MPS2 = 2.5, 4.0  # planned deceleration; the hardest, if the limit comes too soon
_LATERAL_MPS2, _MAX_LATERAL_MPS2 = 2.5, 4.0
"""Lateral acceleration in a bend: usual; the highest that is accepted."""
_SLOWING_FOR_BENDS_MPS2 = 3.0
_STRAIGHT_RAD = 0.2  # an internal lane that turns by less has no bend
FINE_DT_S = CHECK_DT_S / FINE_STEPS
"""Spacing of ``speeds_along``."""
FINE_TIMES_S: FloatArray = FINE_DT_S * np.arange(FINE_STEPS * len(CHECK_TIMES_S) + 1.0)
"""(121,) instants from now on."""


def speeds_along(way: Way, speed_mps: float) -> FloatArray:
    """Return (121,) speeds at ``FINE_TIMES_S`` of a vehicle at *speed_mps* now that meets nobody.

    It accelerates to the limit of its lane, and slows in time for lower limits and for the bends of junctions. If it
    exceeds the limit now, it keeps its speed on its present lane.
    """
    begins, ends, bend_speeds = _bends(way)
    highest = np.minimum([lane.speed_mps for lane in way.lane.lanes], bend_speeds)
    highest[0] = max(float(highest[0]), speed_mps)
    lanes = list(zip(begins.tolist(), ends.tolist(), (highest**2).tolist(), strict=True))
    speed = np.empty(len(FINE_TIMES_S))
    speed[0] = before = speed_mps
    driven = 0.0
    for k in range(1, len(speed)):  # plain numbers are faster: there are few lanes, and each plan does this
        left = ((max(begin - driven, 0.0), squared) for begin, end, squared in lanes if driven < end)
        allowed = [squared + 2.0 * _SLOWING_MPS2 * left_m for left_m, squared in left]
        wish = min(before + SPEEDING_UP_MPS2 * FINE_DT_S, math.sqrt(min(allowed, default=np.inf)))
        after = max(wish, before - _MAX_SLOWING_MPS2 * FINE_DT_S, 0.0)
        driven += 0.5 * (before + after) * FINE_DT_S
        speed[k] = before = after
    return speed


def can_slow_for_bends(way: Way, driven_m: float, speed_mps: float) -> bool:
    """Return whether a vehicle at *speed_mps* after *driven_m* can slow for all bends, to 4 m/s² sideways at most."""
    begins, ends, bend_speeds = _bends(way)
    in_bend = bend_speeds**2 * _MAX_LATERAL_MPS2 / _LATERAL_MPS2
    highest = in_bend + 2.0 * _SLOWING_FOR_BENDS_MPS2 * np.maximum(begins - driven_m, 0.0)
    return bool((speed_mps**2 <= highest)[ends > driven_m].all())


def _bends(way: Way) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where each lane begins and ends (L,), in metres from the box centre, and the speed for its bend."""
    lanes = way.lane.lanes
    ends = np.cumsum([lane.length_m for lane in lanes]) - way.lane.s_m
    begins = np.concatenate(([-np.inf], ends[:-1]))
    return begins, ends, np.array([bend_mps(lane) for lane in lanes])


@lru_cache(maxsize=4096)
def bend_mps(lane: Lane) -> float:
    """Return the speed at which the mean lateral acceleration over an internal lane is 2.5 m/s²; inf elsewhere."""
    if not lane.is_internal:
        return np.inf
    yaw = lane.line.segment_yaw_rad
    turned = abs(float(wrap_angle(float(yaw[-1] - yaw[0]))))
    return np.inf if turned < _STRAIGHT_RAD else float(np.sqrt(_LATERAL_MPS2 * lane.length_m / turned))
