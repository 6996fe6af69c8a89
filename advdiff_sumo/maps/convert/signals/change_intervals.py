"""Yellow and all-red times (ITE, Guidelines for Determining Traffic Signal Change and Clearance Intervals, 2020).

Yellow ``y = t + v / (2a + 2Gg)`` with a reaction time ``t`` of 1 s, a deceleration ``a`` of 10 ft/s² and no grade
``G``; all-red ``r = (w + L) / v`` with a vehicle ``L`` of 20 ft. The bounds are those of the MUTCD (2009, section
4D.26): 3 to 6 s of yellow, at most 6 s of all-red. Both are rounded up to half seconds.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

import shapely
from shapely.geometry import LineString, Point

from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.narrow import Ends
from advdiff_sumo.maps.convert.signals.signal_links import SignalLink
from advdiff_sumo.maps.convert.sources.source_map import Direction

REACTION_S, DECELERATION_MPS2 = 1.0, 3.048
VEHICLE_M = 6.096
SHORTEST_YELLOW_S, LONGEST_YELLOW_S, LONGEST_ALL_RED_S = 3.0, 6.0, 6.0
ROUNDED_TO_S = 0.5


def yellow_s(ending: Iterable[SignalLink]) -> float:
    """Return the yellow time in s of links that lose green together: that of the fastest approach."""
    speed_mps = max(link.approach_mps for link in ending)
    exact_s = REACTION_S + speed_mps / (2.0 * DECELERATION_MPS2)
    return min(max(_rounded_up(exact_s), SHORTEST_YELLOW_S), LONGEST_YELLOW_S)


def all_red_s(
    ending: Iterable[SignalLink], starting: Iterable[SignalLink], apart: Collection[frozenset[Ends]] = ()
) -> float:
    """Return the time in s in which *ending* links get clear of those that get green next; 0: none cross.

    Links in *apart* run along each other for long; those get clear in full, as where one lane serves both directions
    (MUTCD 2009, section 4H.03).
    """
    beginners = list(starting)
    times_s = [
        _clearance_s(link, foe)
        if frozenset((link.ends, foe.ends)) in apart
        else min(_clearance_s(link, foe), LONGEST_ALL_RED_S)
        for link in ending
        for foe in beginners
        if foe.index in link.foes
    ]
    return _rounded_up(max(times_s, default=0.0))


def _clearance_s(link: SignalLink, foe: SignalLink) -> float:
    """Return the time from the stop line until the rear of a vehicle on *link* has left the way of *foe*."""
    line = LineString(link.line_m)
    shared = line.intersection(LineString(foe.line_m).buffer(BODIES_M))
    if shared.is_empty:
        return 0.0
    last_m = max(line.project(Point(place)) for place in shapely.get_coordinates(shared))
    speed_mps = link.approach_mps if link.direction is Direction.STRAIGHT else link.way_mps
    return (link.stop_offset_m + float(last_m) + VEHICLE_M) / speed_mps


def _rounded_up(time_s: float) -> float:
    return ROUNDED_TO_S * math.ceil(time_s / ROUNDED_TO_S - 1e-9)
