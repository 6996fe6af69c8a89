"""Computes yellow and all-red times of traffic lights.

ITE, Guidelines for Determining Traffic Signal Change and Clearance Intervals, 2020:
Yellow ``y = t + v / (2a + 2Gg)`` with a reaction time ``t`` of 1 s, a deceleration ``a`` of 10 ft/s² and no grade
``G``; all-red ``r = (w + L) / v`` with a vehicle ``L`` of 20 ft. The bounds are those of the MUTCD (2009, section
4D.26): 3 to 6 s of yellow, at most 6 s of all-red. Both are rounded up to half seconds.
"""

from __future__ import annotations

import math

_REACTION_S, _DECELERATION_MPS2, _VEHICLE_M = 1.0, 3.048, 6.096
_SHORTEST_YELLOW_S, _LONGEST_YELLOW_S = 3.0, 6.0
LONGEST_ALL_RED_S = 6.0
_ROUNDED_TO_S = 0.5


def yellow_at_s(speed_mps: float) -> float:
    """Return the yellow time in s for an approach at *speed_mps*."""
    rounded_s = rounded_up_s(_REACTION_S + speed_mps / (2.0 * _DECELERATION_MPS2))
    return min(max(rounded_s, _SHORTEST_YELLOW_S), _LONGEST_YELLOW_S)


def clearance_s(way_m: float, speed_mps: float) -> float:
    """Return the time in s, not rounded, that a vehicle needs until its rear is *way_m* beyond the stop line."""
    return (way_m + _VEHICLE_M) / speed_mps


def rounded_up_s(time_s: float) -> float:
    """Return *time_s*, rounded up to a half second."""
    return _ROUNDED_TO_S * math.ceil(time_s / _ROUNDED_TO_S - 1e-9)
