"""The way of a vehicle: the centre line of the lanes that it follows, and the junction links on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.maps.lanes import Lane, Link
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead

_SETTLES_S = 2.0


@dataclass(frozen=True)
class Way:
    """Where a vehicle goes on driving.

    Attributes:
        lane: the lanes it follows and its place on them.
    """

    lane: LaneAhead

    @cached_property
    def line(self) -> Polyline:
        """The centre line of all lanes, internal ones included."""
        return concatenate([lane.line for lane in self.lane.lanes])

    @cached_property
    def links(self) -> tuple[tuple[float, Link], ...]:
        """(distance from the box centre to the stop line, link) of every junction ahead, nearest first."""
        reach = -self.lane.s_m
        links_ahead: list[tuple[float, Link]] = []
        lanes = self.lane.lanes
        for k, lane in enumerate(lanes[:-1]):
            reach += lane.length_m
            if not lane.is_internal:
                links_ahead += [(reach, link) for link in lane.successors if _leads_to(link, lanes[k + 1])][
                    :1
                ]
        return tuple(links_ahead)

    def poses(self, driven_m: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return box centres (…, T, 2) and headings (…, T) after *driven_m* (…, T) metres at *time_s* (T,).

        The lateral offset that the vehicle has now decays within ``_SETTLES_S``.
        """
        left = self.lane.offset_m * (1.0 - smooth_step(time_s / _SETTLES_S))
        return self.line.at(self.lane.s_m + driven_m, np.broadcast_to(left, driven_m.shape), extrapolate=True)

    @property
    def present_lane(self) -> Lane:
        """The lane that the vehicle is on."""
        return self.lane.lanes[0]


def smooth_step(share: FloatArray) -> FloatArray:
    """Return a rise from 0 to 1 with zero slope at both ends, clamped: 3 x² − 2 x³."""
    x = np.clip(share, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def _leads_to(link: Link, lane: Lane) -> bool:
    return lane.id in link.via[:1] or (not link.via and link.to_lane == lane.id)
