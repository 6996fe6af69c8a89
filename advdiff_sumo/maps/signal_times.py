"""Yellow and all-red times (ITE, Guidelines for Determining Traffic Signal Change and Clearance Intervals, 2020).

Yellow ``y = t + v / (2a + 2Gg)`` with a reaction time ``t`` of 1 s, a deceleration ``a`` of 10 ft/s² and no grade
``G``; all-red ``r = (w + L) / v`` with a vehicle ``L`` of 20 ft. The bounds are those of the MUTCD (2009, section
4D.26): 3 to 6 s of yellow, at most 6 s of all-red. Both are rounded up to half seconds.
"""

from __future__ import annotations

import math

REACTION_S, DECELERATION_MPS2 = 1.0, 3.048
VEHICLE_M = 6.096
SHORTEST_YELLOW_S, LONGEST_YELLOW_S, LONGEST_ALL_RED_S = 3.0, 6.0, 6.0
ROUNDED_TO_S = 0.5


def yellow_at_s(speed_mps: float) -> float:
    """Return the yellow time in s for an approach at *speed_mps*."""
    exact_s = rounded_up_s(REACTION_S + speed_mps / (2.0 * DECELERATION_MPS2))
    return min(max(exact_s, SHORTEST_YELLOW_S), LONGEST_YELLOW_S)


def clearance_s(way_m: float, speed_mps: float) -> float:
    """Return the time in s, not rounded, in which the rear of a vehicle has come *way_m* from the stop line."""
    return (way_m + VEHICLE_M) / speed_mps


def rounded_up_s(time_s: float) -> float:
    """Return the next half second."""
    return ROUNDED_TO_S * math.ceil(time_s / ROUNDED_TO_S - 1e-9)
