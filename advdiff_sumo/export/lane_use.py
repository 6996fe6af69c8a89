"""Classifies lanes by the few kinds that other formats distinguish."""

from __future__ import annotations

from enum import StrEnum

from advdiff_sumo.maps import Lane


class LaneKind(StrEnum):
    """Kinds of lanes."""

    CAR = "car"
    BUS = "bus"
    BICYCLE = "bicycle"
    FOOT = "foot"
    OTHER = "other"


def lane_kind(lane: Lane) -> LaneKind:
    """Return the kind of *lane* by the first class that may use it: CAR, BUS (other motor vehicles), BICYCLE, FOOT."""
    if "passenger" in lane.allows:
        return LaneKind.CAR
    if lane.is_drivable:
        return LaneKind.BUS
    for vclass, kind in (("bicycle", LaneKind.BICYCLE), ("pedestrian", LaneKind.FOOT)):
        if vclass in lane.allows:
            return kind
    return LaneKind.OTHER
