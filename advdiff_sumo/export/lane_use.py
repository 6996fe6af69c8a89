"""Who a lane is for, in the few kinds that other formats tell apart."""

from __future__ import annotations

from enum import StrEnum

from advdiff_sumo.maps import Lane


class LaneKind(StrEnum):
    """Kinds of lane."""

    CAR = "car"
    BUS = "bus"
    BICYCLE = "bicycle"
    FOOT = "foot"
    OTHER = "other"


def kind_of(lane: Lane) -> LaneKind:
    """Return the kind of *lane*: cars before buses before bicycles before people on foot."""
    if "passenger" in lane.allows:
        return LaneKind.CAR
    if lane.is_drivable:
        return LaneKind.BUS
    for vclass, kind in (("bicycle", LaneKind.BICYCLE), ("pedestrian", LaneKind.FOOT)):
        if vclass in lane.allows:
            return kind
    return LaneKind.OTHER
