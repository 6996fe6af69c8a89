"""Yellow and all-red times of the links of a signal, by the formulas of :mod:`advdiff_sumo.maps.signal_times`."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import shapely
from shapely.geometry import LineString, Point

from advdiff_sumo.maps.convert.layout.clear_stretches import BODIES_M
from advdiff_sumo.maps.convert.narrow import Ends
from advdiff_sumo.maps.convert.signals.signal_links import SignalLink
from advdiff_sumo.maps.convert.sources.source_map import Direction
from advdiff_sumo.maps.signal_times import LONGEST_ALL_RED_S, clearance_s, rounded_up_s, yellow_at_s


def yellow_s(ending: Iterable[SignalLink]) -> float:
    """Return the yellow time in s of links that lose green together: that of the fastest approach."""
    return yellow_at_s(max(link.approach_mps for link in ending))


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
    return rounded_up_s(max(times_s, default=0.0))


def _clearance_s(link: SignalLink, foe: SignalLink) -> float:
    """Return the time from the stop line until the rear of a vehicle on *link* has left the way of *foe*."""
    line = LineString(link.line_m)
    shared = line.intersection(LineString(foe.line_m).buffer(BODIES_M))
    if shared.is_empty:
        return 0.0
    last_m = max(line.project(Point(place)) for place in shapely.get_coordinates(shared))
    speed_mps = link.approach_mps if link.direction is Direction.STRAIGHT else link.way_mps
    return clearance_s(link.stop_offset_m + float(last_m), speed_mps)
