"""Finds faults of a net that make its episodes meaningless, and says how to mend them.

SUMO accepts such nets without a warning. Vehicles jump over junctions without internal lanes. Nobody yields at
unregulated junctions. Traffic meets head-on where lanes of both directions overlap. Lanes are counted from the wrong
side if the ``lefthand`` attribute is wrong.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.wording import counted
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.maps.opposite_lanes import BODY_M, keeps_left, opposite_offsets_m
from advdiff_sumo.maps.roadmap import RoadMap

_LEAP_M = 1.0  # largest gap between two lanes that need no internal lane between them
_REMEDY = "write it anew with netconvert"


def net_oddities(road: RoadMap) -> list[str]:
    """Return a sentence on each such fault of *road*; none for a sound net."""
    lanes = [lane for lane in road.lanes.values() if lane.is_drivable and not lane.is_internal]
    opposite_m = opposite_offsets_m([lane.line for lane in lanes])
    overlapping_ids = [
        lane.id for lane, is_near in zip(lanes, np.abs(opposite_m) < BODY_M, strict=True) if is_near
    ]
    sentences = (_leaps(road), _unregulated(road), _head_on(overlapping_ids), _other_side(road, opposite_m))
    return [f"{road.path}: {sentence}" for sentence in sentences if sentence]


def _leaps(road: RoadMap) -> str:
    """Return a sentence on junctions without internal lanes, which vehicles cross in no time; "" without any."""
    junctions = {
        link.junction_id
        for (from_lane, to_lane), link in road.links.items()
        if not link.via and _gap_m(road.lanes[from_lane], road.lanes[to_lane]) > _LEAP_M
    }
    if not junctions:
        return ""
    count = counted(len(junctions), "junction")
    return f"vehicles leap over {count} without lanes; {_REMEDY}, without --no-internal-links"


def _gap_m(lane: Lane, after: Lane) -> float:
    return float(np.linalg.norm(after.centre_xy_m[0] - lane.centre_xy_m[-1]))


def _unregulated(road: RoadMap) -> str:
    """Return a sentence on unregulated junctions at which several streets lead into one; "" without any."""
    unregulated = {name for name, junction in road.junctions.items() if junction.type == "unregulated"}
    from_edges = defaultdict[tuple[str, str], set[str]](set)
    for link in road.links.values():
        if link.junction_id in unregulated and not link.turns_round:
            to_edge = road.lanes[link.to_lane].edge_id
            from_edges[link.junction_id, to_edge].add(road.lanes[link.from_lane].edge_id)
    junctions = {junction for (junction, _), edges in from_edges.items() if len(edges) > 1}
    if not junctions:
        return ""
    count = counted(len(junctions), "junction")
    return f"nobody yields at {count} of type 'unregulated'; {_REMEDY}, with another type, such as priority"


def _head_on(lanes: Sequence[str]) -> str:
    """Return a sentence on *lanes* (ids) that a lane of the other direction overlaps; "" without any."""
    if not lanes:
        return ""
    place = f"{counted(len(lanes), 'lane')}, such as '{lanes[0]}',"
    return (
        f"traffic meets head-on on {place} less than {BODY_M:g} m beside one of the other direction; {_REMEDY}, with "
        "spreadType right for streets of two directions"
    )


def _other_side(road: RoadMap, opposite_m: FloatArray) -> str:
    """Return a sentence if the lanes, by their offsets *opposite_m* (N,), contradict ``lefthand``; "" otherwise."""
    is_left = keeps_left(opposite_m)
    if is_left is None or is_left == road.lefthand:
        return ""
    side, option = ("left", "with") if is_left else ("right", "without")
    return f"traffic keeps {side} by its lanes, but not by its 'lefthand'; make it anew {option} --lefthand"
