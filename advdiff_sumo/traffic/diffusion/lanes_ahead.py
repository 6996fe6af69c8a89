"""Where a vehicle is in the lane graph, and what it would drive by simply following its lane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
_SUBSTEPS = 5
_YAW_TOLERANCE_RAD = 1.2


@dataclass(frozen=True)
class LaneAhead:
    """The lane that a vehicle is on and those behind it.

    Attributes:
        s_m: place of the box centre along ``line``.
        line: centre lines, joined.
        speed_mps: the lowest limit within the next few seconds.
        stops: (distance from the box centre to a stop line, its link) of signalled links, nearest first.
        end_m: distance to where the road ends; inf where it goes on.
        offset_m: of the vehicle to the left of its lane.
    """

    s_m: float
    line: Polyline
    speed_mps: float
    stops: tuple[tuple[float, Link], ...]
    end_m: float
    offset_m: float


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
    line = Polyline.of(np.vstack([x.centre_xy_m for x in driven]))
    return LaneAhead(s_m, line, driven[0].speed_mps, tuple(stops), float(end), offset_m)


def _onward(lane: Lane, route: Sequence[str]) -> Link | None:
    """Return the link that follows the route, else the straight one, else the first."""
    links = [link for link in lane.successors if link.direction != "t"] or list(lane.successors)
    if not links:
        return None
    followed = [link for link in links if link.to_lane.rpartition("_")[0] in route]
    straight = [link for link in links if link.direction == "s"]
    return (followed or straight or links)[0]


def follow(
    ahead: LaneAhead,
    xy_m: FloatArray,
    yaw_rad: float,
    speed_mps: float,
    length_m: float,
    steps: int,
    dt_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return states (T, 2), (T,), (T,) of a vehicle that follows its lane at the limit, slower in bends.

    Pure pursuit through the bicycle model; other vehicles and signals are the business of ``braking``.
    """
    limits, length = Limits(), np.asarray(length_m)
    xy, yaw, speed = np.asarray(xy_m, dtype=np.float64), np.asarray(yaw_rad), np.asarray(speed_mps)
    s, small = ahead.s_m, dt_s / _SUBSTEPS
    out = []
    for k in range(steps * _SUBSTEPS):
        accel, bend = _pursue(ahead, s, xy, float(yaw), float(speed))
        a, c = clip_controls(speed, np.asarray(accel), np.asarray(bend), length, limits)
        s += float(speed) * small
        xy, yaw, speed = step(xy, yaw, speed, a, c, small)
        if (k + 1) % _SUBSTEPS == 0:
            out.append((xy, yaw, speed))
    return np.stack([o[0] for o in out]), np.stack([o[1] for o in out]), np.stack([o[2] for o in out])


def _pursue(ahead: LaneAhead, s_m: float, xy: FloatArray, yaw: float, speed: float) -> tuple[float, float]:
    """Return acceleration and curvature towards the lane's centre at its limit."""
    look = max(_MIN_LOOK_AHEAD_M, _LOOK_AHEAD_S * speed)
    goals, headings = ahead.line.at(np.array([s_m + look, s_m + 2.0 * look]), extrapolate=True)
    delta = goals[0] - xy
    angle = float(wrap_angle(np.arctan2(delta[1], delta[0]) - yaw))
    bend = 2.0 * np.sin(angle) / max(float(np.hypot(*delta)), 1.0)
    turn = abs(float(wrap_angle(headings[1] - yaw))) / (2.0 * look)
    wanted = min(ahead.speed_mps, np.sqrt(_LATERAL_MPS2 / max(turn, 1e-3)))
    return float(np.clip(wanted - speed, -_BRAKE_MPS2, _ACCEL_MPS2)), float(bend)
