"""How fast somebody gets along a way who has it to itself: limits and bends that lie ahead are met in time."""

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
"""Acceleration of who goes on, towards the limit."""
_SLOWS_MPS2, _SLOWS_AT_MOST_MPS2 = 2.5, 4.0
_LATERAL_MPS2, _HARD_LATERAL_MPS2, _SLOWS_FOR_BENDS_MPS2 = 2.5, 4.0, 3.0
_STRAIGHT_RAD = 0.2
FINE_DT_S = CHECK_DT_S / FINE_STEPS
"""Spacing of ``speeds_along``."""
FINE_TIMES_S: FloatArray = FINE_DT_S * np.arange(FINE_STEPS * len(CHECK_TIMES_S) + 1.0)
"""(121,) instants from now on."""


def speeds_along(way: Way, speed_mps: float) -> FloatArray:
    """Return (121,) speeds at ``FINE_TIMES_S`` of somebody who drives *speed_mps* now and sees nobody.

    It picks up to the limit of its lane, slows in time for lower ones and for the bends of junctions, and keeps a speed
    above the limit that it has now on the lane that it is on.
    """
    begins, ends, bends = _bends(way)
    highest = np.minimum([lane.speed_mps for lane in way.lane.lanes], bends)
    highest[0] = max(float(highest[0]), speed_mps)
    parts = list(zip(begins.tolist(), ends.tolist(), (highest**2).tolist(), strict=True))
    speed = np.empty(len(FINE_TIMES_S))
    speed[0] = before = speed_mps
    driven = 0.0
    for k in range(1, len(speed)):  # plain numbers: there are few lanes, and this is asked in every plan
        free = [at + 2.0 * _SLOWS_MPS2 * max(begin - driven, 0.0) for begin, end, at in parts if driven < end]
        wish = min(before + SPEEDING_UP_MPS2 * FINE_DT_S, math.sqrt(min(free, default=np.inf)))
        after = max(wish, before - _SLOWS_AT_MOST_MPS2 * FINE_DT_S, 0.0)
        driven += 0.5 * (before + after) * FINE_DT_S
        speed[k] = before = after
    return speed


def can_slow_for_bends(way: Way, driven_m: float, speed_mps: float) -> bool:
    """Return whether who drives *speed_mps* after *driven_m* metres can still slow for bends: to 4 m/s² sideways."""
    begins, ends, bends = _bends(way)
    in_bend = bends**2 * _HARD_LATERAL_MPS2 / _LATERAL_MPS2
    most = in_bend + 2.0 * _SLOWS_FOR_BENDS_MPS2 * np.maximum(begins - driven_m, 0.0)
    return bool((speed_mps**2 <= most)[ends > driven_m].all())


def _bends(way: Way) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where each lane begins and ends (L,), in metres from the box centre, and the speed of its bend."""
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
