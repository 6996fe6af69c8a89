"""Breaches of traffic rules and their kinds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class BreachKind(StrEnum):
    """Traffic rules that a road user can break; the values appear in tables."""

    RED_LIGHT = "red_light"
    WRONG_SIDE = "wrong_side"
    UNSAFE_LANE_ENTRY = "unsafe_lane_entry"
    SIDEWAYS = "sideways"
    RAN_INTO = "ran_into"
    RIGHT_OF_WAY = "right_of_way"
    SPEEDING = "speeding"
    REVERSING = "reversing"
    OFF_ROAD = "off_road"
    CLOSE_FOLLOWING = "close_following"
    NEEDLESS_BRAKING = "needless_braking"


@dataclass(frozen=True)
class Breach:
    """A traffic rule that a road user broke.

    Attributes:
        kind: the rule.
        row: row of the road user.
        time_s: time since the episode's start.
        text: what it did, as a phrase that follows its name: "entered the junction on red".
    """

    kind: BreachKind
    row: int
    time_s: float
    text: str
