"""Progress of the target: along its route, in metres driven, and its speed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.record import EndReason, EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.kinematics import unbroken_steps
from advdiff_sumo.metrics.placement import placement_of

#: The position on the route is determined at this interval.
_EVERY_S = 0.5
#: Positions may advance by this factor and distance more than driven (curves, lanes of unequal length).
_STRETCH = 1.2
_SLACK_M = 5.0


@dataclass(frozen=True)
class Progress:
    """Progress of the target.

    Attributes:
        route_m: distance from its first position on the route to the farthest one; None if never on its route.
        route_share: the same as a share of the route that lay ahead at the start, in [0, 1].
        completed: whether it reached the end of its route.
        distance_m: length of the driven path.
        speed_mean_mps: mean of the absolute speed.
        speed_max_mps: greatest absolute speed.
    """

    route_m: float | None
    route_share: float | None
    completed: bool
    distance_m: float
    speed_mean_mps: float | None
    speed_max_mps: float | None


def progress(record: EpisodeRecord, road: RoadMap) -> Progress:
    """Return the target's progress over the whole record."""
    tracks, row = record.tracks, record.target
    speed = np.abs(tracks.speed_mps[row][tracks.valid[row]])
    positions, length = _positions(record, road), _route_length_m(road, record.route)
    completed = record.end is EndReason.ARRIVED
    route_m = share = None
    if positions:
        ahead = max(length - positions[0], 1e-9)
        route_m = max(positions) - positions[0]
        share = 1.0 if completed else min(1.0, route_m / ahead)
        completed = completed or length - max(positions) <= tracks.size_m[row, 0]
    return Progress(
        route_m=route_m,
        route_share=share,
        completed=bool(completed),
        distance_m=float(_driven_m(record)[-1]),
        speed_mean_mps=float(speed.mean()) if speed.size else None,
        speed_max_mps=float(speed.max()) if speed.size else None,
    )


def _route_length_m(road: RoadMap, route: tuple[str, ...]) -> float:
    starts = _edge_starts(road, route)
    return starts[-1] + road.edges[route[-1]].length_m if starts else 0.0


def _edge_starts(road: RoadMap, route: tuple[str, ...]) -> list[float]:
    """Return the distance along *route* at which each edge begins, junctions included; [] if one is not in the net."""
    if not route or any(edge not in road.edges for edge in route):
        return []
    starts = [0.0]
    for edge, next_edge in pairwise(route):
        starts.append(starts[-1] + road.edges[edge].length_m + _junction_length_m(road, edge, next_edge))
    return starts


def _junction_length_m(road: RoadMap, edge: str, next_edge: str) -> float:
    """Return the length of the shortest way over the junction between two edges."""
    lengths = [
        sum(road.lanes[x].length_m for x in link.via)
        for lane in road.edges[edge].lane_ids
        for link in road.lanes[lane].successors
        if road.lanes[link.to_lane].edge_id == next_edge
    ]
    return min(lengths, default=0.0)


def _positions(record: EpisodeRecord, road: RoadMap) -> list[float]:
    """Return positions along the route, in time order, while the target is on an edge of it or between two.

    If the route passes an edge twice, the second passage counts once the edge before it has been reached.
    """
    starts = _edge_starts(road, record.route)
    if not starts:
        return []
    placement = placement_of(road, record.tracks, record.target, 0, record.tracks.steps)
    every = max(1, round(_EVERY_S / record.tracks.dt_s))
    driven = _driven_m(record)
    positions: list[tuple[float, float]] = []  # position along the route, metres driven until there
    reached = 0
    for k in sorted({*range(0, record.tracks.steps, every), record.tracks.steps - 1}):
        number = _route_edge(road, placement.lane[k], record.route, reached)
        if number is None:
            continue
        s_m = _along_edge(road, record.route[number], str(placement.lane[k]), float(placement.s_m[k]))
        position = starts[number] + s_m
        if positions and position - positions[-1][0] > _STRETCH * (driven[k] - positions[-1][1]) + _SLACK_M:
            continue  # a later edge of the route that lies close by
        reached = number
        positions.append((position, float(driven[k])))
    return [position for position, _ in positions]


def _driven_m(record: EpisodeRecord) -> FloatArray:
    """Return (T,) metres driven by the target since the start."""
    tracks = record.tracks.rows([record.target])
    steps = np.hypot(*np.diff(tracks.xy_m[0], axis=0).T)
    return np.concatenate(([0.0], np.cumsum(np.where(unbroken_steps(tracks)[0], steps, 0.0))))


def _along_edge(road: RoadMap, edge_id: str, lane_id: str, s_m: float) -> float:
    """Return the distance from the start of an edge to a position on one of its lanes or on the junction after it."""
    lane, length = road.lanes[lane_id], road.edges[edge_id].length_m
    return length + s_m if lane.is_internal else s_m * length / lane.length_m


def _route_edge(road: RoadMap, lane_id: str | None, route: tuple[str, ...], reached: int) -> int | None:
    """Return the number, at least *reached*, of the route's edge that a lane belongs to or leads away from."""
    if lane_id is None:
        return None
    lane = road.lanes[lane_id]
    if not lane.is_internal:
        return next((n for n in range(reached, len(route)) if route[n] == lane.edge_id), None)
    for number in range(reached, len(route) - 1):
        for name in road.edges[route[number]].lane_ids:
            for link in road.lanes[name].successors:
                if lane_id in link.via and road.lanes[link.to_lane].edge_id == route[number + 1]:
                    return number
    return None
