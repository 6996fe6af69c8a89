"""Finds the lane that a vehicle is on and the lanes ahead that it would follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane, Link, edge_of_lane

HORIZON_M = 120.0
"""Distance ahead up to which lanes are followed."""
_MOST_LANES = 40
_YAW_TOLERANCE_RAD = 1.2


@dataclass(frozen=True)
class LaneAhead:
    """The lane that a vehicle is on and the lanes that follow it.

    Attributes:
        s_m: arc length of the box centre along the first lane; negative before its beginning.
        lanes: the lanes in driving order, internal ones included.
        speed_mps: speed limit of the first lane.
        stops: (distance from the box centre to a stop line, its link) of signalled links, nearest first.
        end_m: distance to the end of the road; inf if it continues.
        offset_m: lateral offset of the vehicle, positive to the left of the first lane.
    """

    s_m: float
    lanes: tuple[Lane, ...]
    speed_mps: float
    stops: tuple[tuple[float, Link], ...]
    end_m: float
    offset_m: float


def lanes_of_rows(road: RoadMap, scene: Scene, rows: IntArray) -> list[LaneAhead | None]:
    """Return :func:`lanes_ahead` for *rows* of *scene*, where they are now, along their routes."""
    now = scene.history
    routes = [scene.routes[row] for row in rows.tolist()]
    return lanes_ahead(road, now.xy_m[rows, -1], now.yaw_rad[rows, -1], routes)


def lanes_ahead(
    road: RoadMap, xy_m: FloatArray, yaw_rad: FloatArray, routes: Sequence[Sequence[str]]
) -> list[LaneAhead | None]:
    """Return for each of N vehicles the lanes it would follow; None if it is on none, or heads against it.

    Args:
        road: the map.
        xy_m: (N, 2) centres.
        yaw_rad: (N,) headings.
        routes: edges of the route that each is expected to drive; () if unknown.
    """
    ids, s, d, error = road.locate_many(xy_m, yaw_rad)
    ahead: list[LaneAhead | None] = []
    for lane, s_m, offset_m, yaw_error, route in zip(ids, s, d, error, routes, strict=True):
        if lane is None or abs(yaw_error) > _YAW_TOLERANCE_RAD:
            ahead.append(None)
        else:
            ahead.append(lane_ahead(road.lanes, road.lanes[lane], float(s_m), float(offset_m), route))
    return ahead


def lane_ahead(
    lanes: Mapping[str, Lane],
    lane: Lane,
    s_m: float,
    offset_m: float,
    route: Sequence[str] = (),
    horizon_m: float = HORIZON_M,
) -> LaneAhead:
    """Return the lanes that a vehicle would follow.

    Args:
        lanes: lanes of the map by id.
        lane: lane that the vehicle is on.
        s_m: its arc length along *lane*.
        offset_m: its lateral offset, positive to the left.
        route: edges of its route; () if unknown.
        horizon_m: distance ahead up to which lanes are followed.
    """
    followed, stops, distance = [lane], [], lane.length_m - s_m
    end = np.inf
    while distance < horizon_m and len(followed) < _MOST_LANES:
        link = _next_link(followed[-1], route)
        if link is None:
            end = distance
            break
        if link.tls_id is not None and not followed[-1].is_internal:
            stops.append((distance, link))
        for name in (*link.via, link.to_lane):
            followed.append(lanes[name])
            distance += lanes[name].length_m
    return LaneAhead(s_m, tuple(followed), lane.speed_mps, tuple(stops), float(end), offset_m)


def _next_link(lane: Lane, route: Sequence[str]) -> Link | None:
    """Return the link along the route, else the straight one, else the first; U-turns only if there is no other."""
    links = [link for link in lane.successors if not link.turns_round] or list(lane.successors)
    if not links:
        return None
    on_route = [link for link in links if edge_of_lane(link.to_lane) in route]
    straight = [link for link in links if link.direction == "s"]
    return (on_route or straight or links)[0]
