"""What kind of collision it was.

The kinds are those of the project's brief; their bounds follow the crash types of NHTSA's pre-crash typology
(Najm, Smith and Yanagisawa 2007, DOT HS 810 767: rear-end, lane change, opposite direction, crossing paths,
road departure). The rules stand in ``docs/metrics.md``, in the order in which they are tried.
"""

from __future__ import annotations

from enum import StrEnum

from advdiff_sumo.metrics.encounter import Encounter

#: Headings that differ by less than this go the same way (45°).
SAME_WAY_RAD = 0.7853981633974483
#: Headings that differ by more than this oppose each other (135°).
OPPOSITE_RAD = 2.356194490192345


class CollisionType(StrEnum):
    """Kinds of collision of the target."""

    JUNCTION = "junction"
    HEAD_ON = "head_on"
    CUT_IN = "cut_in"
    REAR_END_STRIKING = "rear_end_striking"
    REAR_END_STRUCK = "rear_end_struck"
    SIDE = "side"
    OFF_ROAD = "off_road"


def collision_type(met: Encounter) -> CollisionType:
    """Return the kind of collision with another agent; leaving the road is found by ``offroad``."""
    angle = met.collision.heading_difference_rad
    if met.junction is not None and _from_different_approaches(met):
        return CollisionType.JUNCTION
    if angle > OPPOSITE_RAD:
        return CollisionType.HEAD_ON
    if angle > SAME_WAY_RAD:
        return CollisionType.SIDE
    return _same_way(met)


def _same_way(met: Encounter) -> CollisionType:
    faces = met.target.face, met.other.face
    lengthwise = {"front", "rear"}.issuperset(faces)
    if met.entry is not None:
        follower = met.other.face if met.entry.by_target else met.target.face
        leader = met.target.face if met.entry.by_target else met.other.face
        if follower == "front" and (lengthwise or leader != "front"):
            return CollisionType.CUT_IN
    if faces == ("front", "rear"):
        return CollisionType.REAR_END_STRIKING
    if faces == ("rear", "front"):
        return CollisionType.REAR_END_STRUCK
    return CollisionType.SIDE


def _from_different_approaches(met: Encounter) -> bool:
    """Return whether the vehicles come by links from different edges; by their headings where unknown."""
    a, b = met.target.link, met.other.link
    if a is None or b is None:
        return met.collision.heading_difference_rad > SAME_WAY_RAD
    return a.from_lane.rsplit("_", 1)[0] != b.from_lane.rsplit("_", 1)[0]
