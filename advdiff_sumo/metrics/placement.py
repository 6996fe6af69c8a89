"""On which lane a recorded vehicle is at each instant, and how far it reaches out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import Tracks
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
        """Return how far the box reaches over the nearer edge of its lane; inf off any lane, ≤ 0 inside."""
        if self.lane[instant] is None:
            return float("inf")
        return float(abs(self.d_m[instant]) + self.reach_m[instant] - self.half_width_m[instant])


def place(road: RoadMap, tracks: Tracks, row: int, start: int, stop: int) -> Placement:
    """Return the lanes of agent *row* at instants *start* to *stop* (exclusive)."""
    yaw = tracks.yaw_rad[row, start:stop]
    ids, s, d, error = road.locate_many(tracks.xy_m[row, start:stop], yaw)
    reach = reach_across_m(tracks.size_m[row], error)
    widths = [road.lanes[x].width_m if x is not None else np.nan for x in ids]
    return Placement(tuple(ids), s, d, error, reach, 0.5 * np.array(widths, dtype=np.float64))


def reach_across_m(size_m: FloatArray, yaw_error_rad: FloatArray) -> FloatArray:
    """Return (N,) half the extent across a lane of boxes *size_m*, (N, 2) or (2,), turned by *yaw_error_rad* (N,)."""
    length, width = size_m[..., 0], size_m[..., 1]
    return 0.5 * (np.abs(np.sin(yaw_error_rad)) * length + np.abs(np.cos(yaw_error_rad)) * width)
