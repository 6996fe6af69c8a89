"""The lane of a recorded vehicle at each instant, and how far the vehicle reaches out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.maps import RoadMap


@dataclass(frozen=True)
class Placement:
    """Lanes of one vehicle at T instants.

    Attributes:
        lane: T lane ids, internal ones included; None where no lane is near.
        s_m: (T,) distance along the lane.
        d_m: (T,) distance to the left of the centre line.
        yaw_error_rad: (T,) heading minus the lane's.
        reach_m: (T,) half the width of the box across the lane, its rotation included.
        half_width_m: (T,) half the width of the lane.
    """

    lane: tuple[str | None, ...]
    s_m: FloatArray
    d_m: FloatArray
    yaw_error_rad: FloatArray
    reach_m: FloatArray
    half_width_m: FloatArray

    def overhang_m(self, instant: int) -> float:
        """Return how far the box reaches over the nearer edge of its lane; inf off any lane, 0 or less inside."""
        if self.lane[instant] is None:
            return float("inf")
        return float(abs(self.d_m[instant]) + self.reach_m[instant] - self.half_width_m[instant])


def placement_of(road: RoadMap, tracks: Tracks, row: int, start: int, stop: int) -> Placement:
    """Return the lanes of agent *row* at instants *start* to *stop* (exclusive).

    Only lanes open to motor vehicles count. A bicycle may also be on a bicycle lane, if its centre is.
    """
    xy, yaw = tracks.xy_m[row, start:stop], tracks.yaw_rad[row, start:stop]
    motor = _on_lanes(road, tracks.size_m[row], road.locate_many(xy, yaw))
    if tracks.classes[row] != AgentClass.BICYCLE:
        return motor
    cycle = _on_lanes(road, tracks.size_m[row], road.locate_many(xy, yaw, vclass="bicycle"))
    inside = np.abs(cycle.d_m) <= cycle.half_width_m
    lanes = tuple(a if x else b for x, a, b in zip(inside, cycle.lane, motor.lane, strict=True))
    arrays = [name for name in vars(motor) if name != "lane"]
    return Placement(lanes, **{x: np.where(inside, getattr(cycle, x), getattr(motor, x)) for x in arrays})


def _on_lanes(
    road: RoadMap, size_m: FloatArray, located: tuple[list[str | None], FloatArray, FloatArray, FloatArray]
) -> Placement:
    """Return the placement of a box of *size_m* (2,) from *located*, the result of :meth:`RoadMap.locate_many`."""
    ids, s, d, error = located
    widths = [road.lanes[x].width_m if x is not None else np.nan for x in ids]
    half_width = 0.5 * np.array(widths, dtype=np.float64)
    return Placement(tuple(ids), s, d, error, reach_across_m(size_m, error), half_width)


def reach_across_m(size_m: FloatArray, yaw_error_rad: FloatArray) -> FloatArray:
    """Return (N,) half the extent across a lane of boxes *size_m*, (N, 2) or (2,), turned by *yaw_error_rad* (N,)."""
    length, width = size_m[..., 0], size_m[..., 1]
    return 0.5 * (np.abs(np.sin(yaw_error_rad)) * length + np.abs(np.cos(yaw_error_rad)) * width)
