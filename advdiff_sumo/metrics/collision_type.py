"""Classify the target's collisions by kind.

The bounds follow the crash types of NHTSA's pre-crash typology (Najm, Smith and Yanagisawa 2007, DOT HS 810 767:
rear-end, lane change, opposite direction, crossing paths, road departure). ``docs/metrics.md`` lists the rules in the
order in which they are tried.
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


def collision_type(case: Encounter) -> CollisionType:
    """Return the kind of a collision with another agent; ``offroad`` detects leaving the road."""
    angle = case.collision.heading_difference_rad
    if case.junction is not None and case.crossing:
        return CollisionType.JUNCTION
    if angle > OPPOSITE_RAD:
        return CollisionType.HEAD_ON
    if _cuts_in(case):
        return CollisionType.CUT_IN
    if angle > SAME_WAY_RAD:
        return CollisionType.SIDE
    faces = (case.target.face, case.other.face)
    if faces == ("front", "rear"):
        return CollisionType.REAR_END_STRIKING
    if faces == ("rear", "front"):
        return CollisionType.REAR_END_STRUCK
    return CollisionType.SIDE


def _cuts_in(case: Encounter) -> bool:
    """Return whether one left its lane for that of the other, ahead of it and in the same direction."""
    entry = case.cut_in
    if entry is None or entry.oncoming or not entry.ahead or not entry.leaves_lane:
        return False
    follower, leader = case.parties if entry.row == case.other.row else case.parties[::-1]
    drives_along = entry.leader_mps > 0.0 and leader.first_lane is not None and not leader.is_pedestrian
    return drives_along and follower.face != "rear"
