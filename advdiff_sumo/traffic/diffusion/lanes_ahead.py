"""Where a vehicle is in the lane graph, and what it would drive by simply following its lane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits, clip_controls, step
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane, Link

HORIZON_M = 120.0
_LOOK_AHEAD_S, _MIN_LOOK_AHEAD_M = 0.8, 4.0
_ACCEL_MPS2, _BRAKE_MPS2, _LATERAL_MPS2 = 1.5, 2.5, 2.0
_SUBSTEPS = 2
_EVERY_M, _REACH_M = 0.5, 160.0
_YAW_TOLERANCE_RAD = 1.2


@dataclass(frozen=True)
class LaneAhead:
    """The lane that a vehicle is on and those behind it.

    Attributes:
        s_m: place of the box centre along ``line``.
        lanes: the lanes in driving order, internal ones included.
        speed_mps: the lowest limit within the next few seconds.
        stops: (distance from the box centre to a stop line, its link) of signalled links, nearest first.
        end_m: distance to where the road ends; inf where it goes on.
        offset_m: of the vehicle to the left of its lane.
    """

    s_m: float
    lanes: tuple[Lane, ...]
    speed_mps: float
    stops: tuple[tuple[float, Link], ...]
    end_m: float
    offset_m: float

    @cached_property
    def line(self) -> Polyline:
        """The centre lines, joined; made only where somebody follows them."""
        return Polyline.of(np.vstack([x.centre_xy_m for x in self.lanes]))


def lanes_ahead(
    road: RoadMap, xy_m: FloatArray, yaw_rad: FloatArray, routes: Sequence[Sequence[str]]
) -> list[LaneAhead | None]:
    """Return for each of N vehicles the lanes it would follow; None where it is on none, or against it.

    Args:
        road: the map.
        xy_m: (N, 2) centres.
        yaw_rad: (N,) headings.
        routes: edges that each is expected to drive; () where unknown.
    """
    ids, s, d, error = road.locate_many(xy_m, yaw_rad)
    out: list[LaneAhead | None] = []
    for lane, at, beside, turned, route in zip(ids, s, d, error, routes, strict=True):
        if lane is None or abs(turned) > _YAW_TOLERANCE_RAD:
            out.append(None)
        else:
            out.append(_ahead(road.lanes, road.lanes[lane], float(at), float(beside), route))
    return out


def _ahead(
    lanes: Mapping[str, Lane], lane: Lane, s_m: float, offset_m: float, route: Sequence[str]
) -> LaneAhead:
    driven, stops, reach = [lane], [], lane.length_m - s_m
    end = np.inf
    while reach < HORIZON_M and len(driven) < 40:
        link = _onward(driven[-1], route)
        if link is None:
            end = reach
            break
        if link.tls_id is not None and not driven[-1].is_internal:
            stops.append((reach, link))
        for name in (*link.via, link.to_lane):
            driven.append(lanes[name])
            reach += lanes[name].length_m
    return LaneAhead(s_m, tuple(driven), driven[0].speed_mps, tuple(stops), float(end), offset_m)


def _onward(lane: Lane, route: Sequence[str]) -> Link | None:
    """Return the link that follows the route, else the straight one, else the first."""
    links = [link for link in lane.successors if link.direction != "t"] or list(lane.successors)
    if not links:
        return None
    followed = [link for link in links if link.to_lane.rpartition("_")[0] in route]
    straight = [link for link in links if link.direction == "s"]
    return (followed or straight or links)[0]


def follow(
    lanes: Sequence[LaneAhead],
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    length_m: FloatArray,
    steps: int,
    dt_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return states (V, T, 2), (V, T), (V, T) of V vehicles that follow their lanes at the limit, slower in bends.

    Pure pursuit through the bicycle model; other vehicles and signals are the business of ``braking``.

    Args:
        lanes: of each vehicle.
        xy_m: (V, 2) centres.
        yaw_rad: (V,) headings.
        speed_mps: (V,) speeds.
        length_m: (V,) lengths.
        steps: T.
        dt_s: spacing.
    """
    limits, small = Limits(), dt_s / _SUBSTEPS
    limit = np.array([lane.speed_mps for lane in lanes])
    points, headings = _ahead_of(lanes)
    xy, yaw, speed, s = xy_m, yaw_rad, np.maximum(speed_mps, 0.0), np.zeros(len(lanes))
    out = []
    for k in range(steps * _SUBSTEPS):
        accel, bend = _pursue(points, headings, limit, s, (xy, yaw, speed))
        accel, bend = clip_controls(speed, accel, bend, length_m, limits)
        s = s + speed * small
        xy, yaw, speed = step(xy, yaw, speed, accel, bend, small)
        if (k + 1) % _SUBSTEPS == 0:
            out.append((xy, yaw, speed))
    return (
        np.stack([o[0] for o in out], axis=1),
        np.stack([o[1] for o in out], axis=1),
        np.stack([o[2] for o in out], axis=1),
    )


def _ahead_of(lanes: Sequence[LaneAhead]) -> tuple[FloatArray, FloatArray]:
    """Return points (V, P, 2) every metre along the lanes from the vehicles on, and headings (V, P)."""
    along: FloatArray = np.arange(0.0, _REACH_M, _EVERY_M, dtype=np.float64)
    made = [lane.line.at(lane.s_m + along, extrapolate=True) for lane in lanes]
    return np.stack([points for points, _ in made]), np.stack([headings for _, headings in made])


def _pursue(
    points: FloatArray,
    headings: FloatArray,
    limit_mps: FloatArray,
    s_m: FloatArray,
    state: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return accelerations and curvatures (V,) towards the lanes' centres at their limits."""
    xy, yaw, speed = state
    look = np.maximum(_MIN_LOOK_AHEAD_M, _LOOK_AHEAD_S * speed)
    row, last = np.arange(len(s_m)), points.shape[1] - 1
    near, far = (np.minimum(np.rint((s_m + k * look) / _EVERY_M).astype(np.int64), last) for k in (1.0, 2.0))
    delta = points[row, near] - xy
    angle = wrap_angle(np.arctan2(delta[:, 1], delta[:, 0]) - yaw)
    bend = 2.0 * np.sin(angle) / np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1.0)
    turn = np.abs(wrap_angle(headings[row, far] - yaw)) / (2.0 * look)
    wanted = np.minimum(limit_mps, np.sqrt(_LATERAL_MPS2 / np.maximum(turn, 1e-3)))
    return np.clip(wanted - speed, -_BRAKE_MPS2, _ACCEL_MPS2), bend
