"""The way of a vehicle: the centre line of the lanes that it follows, and the junction links on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.maps.lanes import Lane, Link
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead

_CENTRING_S = 2.0  # driving time within which a vehicle returns to the centre line of its lane
_MIN_DRIFT_MPS = 0.2  # a slower lateral speed does not change the heading
_MIN_COURSE_M = 0.12  # shortest stride between two instants from which a heading is derived
MIN_STRIDE_M = 0.01
"""A vehicle that drives less than this between two instants stands."""


@dataclass(frozen=True)
class Way:
    """The lanes that a vehicle will follow, and its place on them.

    Attributes:
        lane: the lanes, and the vehicle's place on them.
        drift_mps: lateral speed of the vehicle, positive to the left.
        keeps_left_m: lateral place that the vehicle keeps, left of the centre line.
    """

    lane: LaneAhead
    drift_mps: float = 0.0
    keeps_left_m: float = 0.0

    @cached_property
    def line(self) -> Polyline:
        """The centre line of all lanes, internal ones included."""
        return concatenate([lane.line for lane in self.lane.lanes])

    @cached_property
    def links(self) -> tuple[tuple[float, Link], ...]:
        """(distance from the box centre to the stop line, link) of every junction ahead, nearest first."""
        line_m = -self.lane.s_m
        links_ahead: list[tuple[float, Link]] = []
        lanes = self.lane.lanes
        for k, lane in enumerate(lanes[:-1]):
            line_m += lane.length_m
            if not lane.is_internal:
                onward = [(line_m, link) for link in lane.successors if _leads_to(link, lanes[k + 1])]
                links_ahead += onward[:1]
        return tuple(links_ahead)

    def poses(self, driven_m: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return box centres (…, T, 2) and headings (…, T) after *driven_m* (…, T) metres at *time_s* (T,).

        The present lateral offset from ``keeps_left_m``, and the lateral speed, decay within ``_CENTRING_S`` of
        driving. A vehicle that moves sideways faces its course.
        """
        moving_s = time_in_motion_s(driven_m, time_s)
        off_place_m = self.lane.offset_m - self.keeps_left_m
        left_m = self.keeps_left_m + settling_offsets_m(off_place_m, self.drift_mps, moving_s, _CENTRING_S)
        xy, lane_yaw = self.line.at(self.lane.s_m + driven_m, left_m, extrapolate=True)
        if abs(self.drift_mps) < _MIN_DRIFT_MPS and not self.keeps_left_m:
            return xy, lane_yaw
        start = self.line.at(self.lane.s_m, self.lane.offset_m)[0]
        return xy, course_headings(start, xy, driven_m, lane_yaw)

    def with_drift(self, past_xy_m: FloatArray, dt_s: float) -> Way:
        """Return this way with the lateral speed that follows from positions (P, 2), *dt_s* apart, the last one now.

        It is the second-order backward difference of the offsets. It is the first-order one if only the last two
        positions lie on the line, and 0 if only one does.
        """
        s, left = self.line.project(past_xy_m[::-1], extrapolate=True)
        count = int(np.argmin(np.append(np.isfinite(s) & (s >= 0.0), False)))
        if count < 2:
            return replace(self, drift_mps=0.0)
        rise = (3.0 * left[0] - 4.0 * left[1] + left[2]) / 2.0 if count > 2 else left[0] - left[1]
        return replace(self, drift_mps=float(rise) / dt_s)

    @property
    def present_lane(self) -> Lane:
        """The lane that the vehicle is on."""
        return self.lane.lanes[0]


def lane_at(way: Way, s_m: float) -> tuple[Lane, float]:
    """Return the lane of *way* that is *s_m* from the beginning of its first lane, and the place on that lane."""
    for lane in way.lane.lanes:
        if s_m <= lane.length_m:
            return lane, s_m
        s_m -= lane.length_m
    last = way.lane.lanes[-1]
    return last, last.length_m


def time_in_motion_s(driven_m: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return for how long (…, T) a vehicle that drives *driven_m* (…, T) has been in motion by *time_s* (T,)."""
    is_moving = np.diff(driven_m, axis=-1, prepend=0.0) > MIN_STRIDE_M
    return np.cumsum(np.diff(time_s, prepend=0.0) * is_moving, axis=-1)


def settling_offsets_m(offset_m: float, drift_mps: float, since_s: FloatArray, lasts_s: float) -> FloatArray:
    """Return lateral offsets (…, T) of a vehicle that moves onto a line along a cubic.

    The cubic begins with the present offset and lateral speed, and ends on the line and parallel to it.

    Args:
        offset_m: present offset.
        drift_mps: present rate of the offset. It is limited so that the cubic does not cross the line.
        since_s: (…, T) times from now.
        lasts_s: duration until the line is reached.
    """
    x = np.clip(since_s / lasts_s, 0.0, 1.0)
    side = np.sign(offset_m)
    slope_m = side * max(side * drift_mps * lasts_s, -3.0 * abs(offset_m)) if side else drift_mps * lasts_s
    return np.asarray((1.0 - x) ** 2 * (offset_m * (1.0 + 2.0 * x) + slope_m * x))


def course_headings(
    start_m: FloatArray, xy_m: FloatArray, driven_m: FloatArray, default_rad: FloatArray
) -> FloatArray:
    """Return headings (…, T) along a course; a vehicle that stands keeps its last heading.

    Args:
        start_m: (2,) present position.
        xy_m: (…, T, 2) positions that follow.
        driven_m: (…, T) distances driven along the lane, lateral motion not included.
        default_rad: (…, T) headings where the vehicle hardly moves.
    """
    start = np.broadcast_to(start_m, (*xy_m.shape[:-2], 1, 2))
    stride = np.gradient(np.concatenate((start, xy_m), axis=-2), axis=-2)[..., 1:, :]
    forward = np.diff(driven_m, axis=-1, prepend=0.0)
    has_course = (forward > _MIN_COURSE_M) & (np.hypot(stride[..., 0], stride[..., 1]) > _MIN_COURSE_M)
    yaw = np.where(has_course, np.arctan2(stride[..., 1], stride[..., 0]), default_rad)
    last = np.maximum.accumulate(np.where(forward > MIN_STRIDE_M, np.arange(yaw.shape[-1]), -1), axis=-1)
    return np.where(last < 0, default_rad, np.take_along_axis(yaw, np.maximum(last, 0), axis=-1))


def _leads_to(link: Link, lane: Lane) -> bool:
    return lane.id in link.via[:1] or (not link.via and link.to_lane == lane.id)
