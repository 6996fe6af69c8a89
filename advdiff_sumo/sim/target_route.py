"""Routes of targets: what is left of one, whether it turns round, and one that needs a lane change beside traffic."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import islice, pairwise, takewhile
from typing import Any

import numpy as np

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import SIDES, Lane, Side, lanes_beside
from advdiff_sumo.sim.situations import gaps_along
from advdiff_sumo.sim.world import Frame, World

_LEAST_M, _LEAST_S = 50.0, 6.0
"""Least distance for each lane change, and at the target's speed."""
_FARTHEST_M, _FARTHEST_S = 100.0, 20.0
"""The changes are due within this distance, or at the target's speed within this time; the larger counts."""
_MOST_CHANGES = 3
_BEHIND_M, _AHEAD_M = 14.0, 5.0  # place of the vehicle beside, from centre to centre along the lane
_DRAWS = 8  # of a random route


def remaining_route(api: Any, name: str, beyond_rim: Collection[str]) -> tuple[str, ...]:
    """Return the edges of vehicle *name* from its present edge on, up to the first that lies *beyond_rim*."""
    vehicle = api.vehicle
    ahead = vehicle.getRoute(name)[max(vehicle.getRouteIndex(name), 0) :]
    return tuple(takewhile(lambda edge: edge not in beyond_rim, ahead))


def turns_round(road: RoadMap, before: str, after: str) -> bool:
    """Return whether all links from *before* to *after* are U-turns: SUMO turns on the spot, a car cannot."""
    links = (link for lane in road.edges[before].lane_ids for link in road.lanes[lane].successors)
    directions = {link.direction for link in links if road.lanes[link.to_lane].edge_id == after}
    return bool(directions) and directions <= {"t", "T"}


def lane_change_route(
    road: RoadMap,
    world: World,
    frame: Frame,
    row: int,
    route: Sequence[str],
    least_m: float,
    rng: np.random.Generator,
) -> tuple[str, ...] | None:
    """Return a route for which the vehicle in *row* soon has to change lanes; None without any.

    On the next lane, to which it has to change first, a vehicle drives beside it. The route is *route* itself if that
    will do, else a random one.

    Args:
        road: the net.
        world: names and lanes of the rows.
        frame: the states.
        row: of the vehicle.
        route: its edges from the present one on.
        least_m: least length of the route, from the vehicle on.
        rng: draws among the routes.
    """
    beginnings = _beginnings(road, world, frame, row)
    if any(tuple(route[: len(edges)]) == edges for edges in beginnings):
        return tuple(route)
    lane = road.lanes[world.lane[row]]
    driven_m = float(lane.line.project(frame.xy_m[row])[0])
    for _ in range(_DRAWS if beginnings else 0):
        edges = beginnings[int(rng.integers(len(beginnings)))]
        begun_m = sum(road.edges[edge].length_m for edge in edges) - driven_m
        onward = road.edge_graph().random(edges[-1], max(least_m - begun_m, 0.0), rng)
        drawn = tuple(takewhile(lambda edge: edge not in road.beyond_rim, (*edges, *onward[1:])))
        length_m = sum(road.edges[edge].length_m for edge in drawn) - driven_m
        is_whole = len(drawn) >= len(edges) and length_m >= least_m
        if is_whole and not any(turns_round(road, *pair) for pair in pairwise(drawn)):
            return drawn
    return None


def _beginnings(road: RoadMap, world: World, frame: Frame, row: int) -> list[tuple[str, ...]]:
    """Return the beginnings of routes, from the present edge to the first that needs a lane change, sorted."""
    lane = road.lanes[world.lane[row]]
    sides = [side for side in SIDES if _is_anyone_beside(road, world, frame, row, side)]
    speed_mps = float(frame.speed_mps[row])
    change_m, farthest_m = max(_LEAST_M, _LEAST_S * speed_mps), max(_FARTHEST_M, _FARTHEST_S * speed_mps)
    room_m, edges = -float(lane.line.project(frame.xy_m[row])[0]), tuple[str, ...]()
    beginnings: set[tuple[str, ...]] = set()
    while sides and room_m + lane.length_m <= farthest_m:
        room_m, edges = room_m + lane.length_m, (*edges, lane.edge_id)
        for side in sides:
            beside = takewhile(lambda x: x.permits("passenger"), lanes_beside(road.lanes, lane.id, side))
            within_reach = islice(beside, min(int(room_m / change_m), _MOST_CHANGES))
            following = {edge for x in within_reach for edge in _following_edges(road, x)}
            beginnings |= {(*edges, edge) for edge in following - _following_edges(road, lane)}
        following_lanes = _following_lanes(road, lane)
        if len({x.edge_id for x in following_lanes}) != 1:
            break
        lane = following_lanes[0]
    return sorted(beginnings)


def _is_anyone_beside(road: RoadMap, world: World, frame: Frame, row: int, side: Side) -> bool:
    """Return whether a vehicle is on the next lane to that side of *row*, beside it."""
    lane = next(lanes_beside(road.lanes, world.lane[row], side), None)
    gaps_m = gaps_along(road, world, frame, row, lane.id) if lane is not None else ()
    return any(-_BEHIND_M < gap_m < _AHEAD_M for gap_m in gaps_m)


def _following_edges(road: RoadMap, lane: Lane) -> set[str]:
    """Return the edges to which cars may drive on from *lane*."""
    return {following.edge_id for following in _following_lanes(road, lane)}


def _following_lanes(road: RoadMap, lane: Lane) -> list[Lane]:
    """Return the lanes to which cars may drive on from *lane*."""
    following = (road.lanes[link.to_lane] for link in lane.successors)
    return [beyond for beyond in following if beyond.permits("passenger")]
