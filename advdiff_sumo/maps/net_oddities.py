"""What of a net makes episodes on it say little, and what to do about it.

SUMO takes such nets without a word: vehicles leap over junctions without lanes, nobody yields where a junction is
unregulated, traffic meets head-on where the lanes of both directions lie on each other, and lanes count from the wrong
side where a net does not say that traffic keeps left.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.wording import counted
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.maps.opposite_lanes import BODY_M, from_opposite_m, keeps_left
from advdiff_sumo.maps.roadmap import RoadMap

_LEAP_M = 1.0  # longest way between two lanes that need none between them
_ANEW = "write it anew with netconvert"


def net_oddities(road: RoadMap) -> list[str]:
    """Return sentences on what of *road* makes its episodes say little; none for a sound net."""
    lanes = [lane for lane in road.lanes.values() if lane.is_drivable and not lane.is_internal]
    opposite_m = from_opposite_m([lane.line for lane in lanes])
    on_each_other = [lane.id for lane, near in zip(lanes, np.abs(opposite_m) < BODY_M, strict=True) if near]
    sentences = (_leaps(road), _unregulated(road), _head_on(on_each_other), _other_side(road, opposite_m))
    return [f"{road.path}: {sentence}" for sentence in sentences if sentence]


def _leaps(road: RoadMap) -> str:
    """Return a sentence on junctions without lanes of their own, which vehicles cross in no time."""
    junctions = {
        link.junction_id
        for (start, end), link in road.links.items()
        if not link.via and _gap_m(road.lanes[start], road.lanes[end]) > _LEAP_M
    }
    if not junctions:
        return ""
    count = counted(len(junctions), "junction")
    return f"vehicles leap over {count} without lanes; {_ANEW}, without --no-internal-links"


def _gap_m(lane: Lane, after: Lane) -> float:
    return float(np.linalg.norm(after.centre_xy_m[0] - lane.centre_xy_m[-1]))


def _unregulated(road: RoadMap) -> str:
    """Return a sentence on junctions at which several streets lead into one and nobody has to yield."""
    free = {name for name, junction in road.junctions.items() if junction.type == "unregulated"}
    into = defaultdict[tuple[str, str], set[str]](set)
    for link in road.links.values():
        if link.junction_id in free and not link.turns_round:
            street = road.lanes[link.to_lane].edge_id
            into[link.junction_id, street].add(road.lanes[link.from_lane].edge_id)
    junctions = {junction for (junction, _), streets in into.items() if len(streets) > 1}
    if not junctions:
        return ""
    count = counted(len(junctions), "junction")
    return f"nobody yields at {count} of type 'unregulated'; {_ANEW}, with another type, such as priority"


def _head_on(lanes: Sequence[str]) -> str:
    """Return a sentence on *lanes* on which one of the other direction lies."""
    if not lanes:
        return ""
    which = f"{counted(len(lanes), 'lane')}, such as '{lanes[0]}',"
    return (
        f"traffic meets head-on on {which} less than {BODY_M:g} m beside one of the other direction; {_ANEW}, with "
        "spreadType right for streets of two directions"
    )


def _other_side(road: RoadMap, opposite_m: FloatArray) -> str:
    """Return a sentence on a net whose lanes, *opposite_m* from those of the other direction, are on the other side."""
    left = keeps_left(opposite_m)
    if left is None or left == road.lefthand:
        return ""
    side, option = ("left", "with") if left else ("right", "without")
    return f"traffic keeps {side} by its lanes, but not by its 'lefthand'; make it anew {option} --lefthand"
