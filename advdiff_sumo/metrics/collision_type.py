"""What kind of collision it was.

The kinds are those of the project's brief; their bounds follow the crash types of NHTSA's pre-crash typology
(Najm, Smith and Yanagisawa 2007, DOT HS 810 767: rear-end, lane change, opposite direction, crossing paths,
road departure). The rules stand in ``docs/metrics.md``, in the order in which they are tried.
"""

from __future__ import annotations

from enum import StrEnum

from advdiff_sumo.metrics.breaches.lane_rules import SAME_WAY_RAD
from advdiff_sumo.metrics.encounter import Encounter
from advdiff_sumo.metrics.lane_entry import OPPOSITE_RAD


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
    if met.junction is not None and met.crossing:
        return CollisionType.JUNCTION
    if angle > OPPOSITE_RAD:
        return CollisionType.HEAD_ON
    if _cuts_in(met):
        return CollisionType.CUT_IN
    if angle > SAME_WAY_RAD:
        return CollisionType.SIDE
    faces = (met.target.face, met.other.face)
    if faces == ("front", "rear"):
        return CollisionType.REAR_END_STRIKING
    if faces == ("rear", "front"):
        return CollisionType.REAR_END_STRUCK
    return CollisionType.SIDE


def _cuts_in(met: Encounter) -> bool:
    """Return whether one entered the lane of the other from ahead, the same way, by leaving its own."""
    entry = met.cut_in
    if entry is None or entry.oncoming or not entry.ahead or not entry.leaves_lane:
        return False
    follower, leader = met.parties if entry.row == met.other.row else met.parties[::-1]
    along = entry.leader_mps > 0.0 and leader.first_lane is not None and not leader.is_pedestrian
    return along and follower.face != "rear"
