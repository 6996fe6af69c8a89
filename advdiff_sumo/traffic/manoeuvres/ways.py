"""The way of a vehicle: the centre line of the lanes that it follows, and the junction links on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.maps.lanes import Lane, Link
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead

_SETTLES_S = 2.0
_DRIFTS_MPS = 0.2
_TURNS_M = 0.12
"""Least stride from one instant to the next that tells where somebody faces."""
MIN_STRIDE_M = 0.01
"""Shorter strides are none."""


@dataclass(frozen=True)
class Way:
    """Where a vehicle goes on driving.

    Attributes:
        lane: the lanes it follows and its place on them.
        drift_mps: how fast it moves to the left of them.
    """

    lane: LaneAhead
    drift_mps: float = 0.0

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

        The lateral offset and drift that the vehicle has now decay within ``_SETTLES_S`` of driving; who drifts faces
        its course.
        """
        left = settling_offsets_m(
            self.lane.offset_m, self.drift_mps, time_in_motion_s(driven_m, time_s), _SETTLES_S
        )
        xy, along = self.line.at(self.lane.s_m + driven_m, left, extrapolate=True)
        if abs(self.drift_mps) < _DRIFTS_MPS:
            return xy, along
        return xy, course_headings(self.line.at(self.lane.s_m, self.lane.offset_m)[0], xy, driven_m, along)

    def with_drift(self, past_xy_m: FloatArray, dt_s: float) -> Way:
        """Return this way with the drift of who was at *past_xy_m* (P, 2), *dt_s* apart, the last of them now.

        Second-order backward difference of the offsets; first-order where two places lie on the line, and 0 for one.
        """
        s, left = self.line.project(past_xy_m[::-1], extrapolate=True)
        known = int(np.argmin(np.append(np.isfinite(s) & (s >= 0.0), False)))
        if known < 2:
            return replace(self, drift_mps=0.0)
        rise = (3.0 * left[0] - 4.0 * left[1] + left[2]) / 2.0 if known > 2 else left[0] - left[1]
        return replace(self, drift_mps=float(rise) / dt_s)

    @property
    def present_lane(self) -> Lane:
        """The lane that the vehicle is on."""
        return self.lane.lanes[0]


def time_in_motion_s(driven_m: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return for how long (…, T) who has driven *driven_m* (…, T) metres at *time_s* (T,) has moved by then."""
    moves = np.diff(driven_m, axis=-1, prepend=0.0) > MIN_STRIDE_M
    return np.cumsum(np.diff(time_s, prepend=0.0) * moves, axis=-1)


def settling_offsets_m(offset_m: float, drift_mps: float, since_s: FloatArray, lasts_s: float) -> FloatArray:
    """Return offsets (…, T) on the way to a line: the cubic that begins as now and ends on the line and along it.

    Args:
        offset_m: now.
        drift_mps: how fast the offset grows now; where it shrinks so fast that the cubic would cross the line, less.
        since_s: (…, T) times from now.
        lasts_s: when it is on the line.
    """
    x = np.clip(since_s / lasts_s, 0.0, 1.0)
    side = np.sign(offset_m)
    begins = side * max(side * drift_mps * lasts_s, -3.0 * abs(offset_m)) if side else drift_mps * lasts_s
    return np.asarray((1.0 - x) ** 2 * (offset_m * (1.0 + 2.0 * x) + begins * x))


def course_headings(
    here_m: FloatArray, xy_m: FloatArray, driven_m: FloatArray, along_rad: FloatArray
) -> FloatArray:
    """Return headings (…, T) along the course from *here_m* (2,) through *xy_m* (…, T, 2).

    Args:
        here_m: where it begins.
        xy_m: where it leads.
        driven_m: (…, T) distances driven, without what is driven sideways.
        along_rad: (…, T) headings where next to nothing is driven; who then stands keeps its heading.
    """
    begin = np.broadcast_to(here_m, (*xy_m.shape[:-2], 1, 2))
    stride = np.gradient(np.concatenate((begin, xy_m), axis=-2), axis=-2)[..., 1:, :]
    forward = np.diff(driven_m, axis=-1, prepend=0.0)
    turns = (forward > _TURNS_M) & (np.hypot(stride[..., 0], stride[..., 1]) > _TURNS_M)
    yaw = np.where(turns, np.arctan2(stride[..., 1], stride[..., 0]), along_rad)
    last = np.maximum.accumulate(np.where(forward > MIN_STRIDE_M, np.arange(yaw.shape[-1]), -1), axis=-1)
    return np.where(last < 0, along_rad, np.take_along_axis(yaw, np.maximum(last, 0), axis=-1))


def _leads_to(link: Link, lane: Lane) -> bool:
    return lane.id in link.via[:1] or (not link.via and link.to_lane == lane.id)
