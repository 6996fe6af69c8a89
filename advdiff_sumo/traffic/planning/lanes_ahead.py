"""Where a vehicle is in the lane graph, and what lies ahead of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane, Link

HORIZON_M = 120.0
_YAW_TOLERANCE_RAD = 1.2


@dataclass(frozen=True)
class LaneAhead:
    """The lane that a vehicle is on and those that follow.

    Attributes:
        s_m: place of the box centre along the first lane; negative before its beginning.
        lanes: the lanes in driving order, internal ones included.
        speed_mps: the limit of the lane that it is on.
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
            out.append(lane_ahead(road.lanes, road.lanes[lane], float(at), float(beside), route))
    return out


def lane_ahead(
    lanes: Mapping[str, Lane],
    lane: Lane,
    s_m: float,
    offset_m: float,
    route: Sequence[str] = (),
    horizon_m: float = HORIZON_M,
) -> LaneAhead:
    """Return what lies ahead at *s_m* along *lane*, *offset_m* to its left, for who drives *route*, to *horizon_m*."""
    driven, stops, reach = [lane], [], lane.length_m - s_m
    end = np.inf
    while reach < horizon_m and len(driven) < 40:
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
    links = [link for link in lane.successors if not link.turns_round] or list(lane.successors)
    if not links:
        return None
    followed = [link for link in links if link.to_lane.rpartition("_")[0] in route]
    straight = [link for link in links if link.direction == "s"]
    return (followed or straight or links)[0]
