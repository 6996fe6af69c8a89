"""Situations in which a seed scene may catch its target: following, merging, yielding, turning, before a red light."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from advdiff_sumo.core.signal_letters import RED
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.sim.sim_options import Situation
from advdiff_sumo.sim.world import Frame, World

_FOLLOWS_S, _BESIDE_M, _JUNCTION_M = 3.5, 20.0, 60.0


def in_situation(
    situation: Situation,
    road: RoadMap,
    world: World,
    frame: Frame,
    row: int,
    route: Sequence[str],
    signals: Mapping[str, str],
) -> bool:
    """Return whether the vehicle in *row* is in *situation* in *frame*.

    Args:
        situation: "following": somebody ahead in its lane, nearer than 3.5 s of its speed; "merging": somebody on a
            lane beside it, within 20 m; "yielding": it is the next one at a junction within 60 m, and has to give
            way there; "turning": its route turns there; "red-light": it is the next one there, and its light is red;
            "any": always.
        road: the net.
        world: names and lanes of the rows.
        frame: the states.
        row: of the vehicle.
        route: its edges from the present one on.
        signals: what every traffic light shows.
    """
    if situation == "red-light":
        link = _next_link(road, world, frame, row, route)
        return link is not None and link.signal(signals) in RED and _is_next(road, world, frame, row)
    return situation == "any" or _TESTS[situation](road, world, frame, row, route)


def _others_along(road: RoadMap, world: World, frame: Frame, row: int, lane_id: str) -> list[float]:
    """Return how far ahead of *row* the others on *lane_id* are, in metres along it."""
    line = road.lanes[lane_id].line
    own = float(line.project(frame.xy_m[row])[0])
    there = [k for k in np.flatnonzero(frame.present).tolist() if k != row and world.lane[k] == lane_id]
    return [float(line.project(frame.xy_m[k])[0]) - own for k in there]


def _following(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> bool:  # noqa: ARG001 - one signature for all tests
    reach = max(_FOLLOWS_S * float(frame.speed_mps[row]), 10.0)
    return any(0.0 < gap < reach for gap in _others_along(road, world, frame, row, world.lane[row]))


def _merging(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> bool:  # noqa: ARG001 - one signature for all tests
    lane = road.lanes[world.lane[row]]
    beside = [name for name in (lane.left_id, lane.right_id) if name is not None]
    return any(abs(gap) < _BESIDE_M for n in beside for gap in _others_along(road, world, frame, row, n))


def _yielding(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> bool:
    link = _next_link(road, world, frame, row, route)
    return link is not None and _is_next(road, world, frame, row) and bool(road.yields_to(link))


def _is_next(road: RoadMap, world: World, frame: Frame, row: int) -> bool:
    """Return whether nobody is ahead of *row* on its lane."""
    return max(_others_along(road, world, frame, row, world.lane[row]), default=0.0) <= 0.0


def _turning(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> bool:
    link = _next_link(road, world, frame, row, route)
    return link is not None and link.direction.lower() in ("l", "r")


def _next_link(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> Link | None:
    """Return the link of the route's next junction where that is near; None otherwise."""
    lane = road.lanes[world.lane[row]]
    left_m = lane.length_m - float(lane.line.project(frame.xy_m[row])[0])
    if left_m > _JUNCTION_M or len(route) < 2:
        return None
    onward = (link for link in lane.successors if road.lanes[link.to_lane].edge_id == route[1])
    return next(onward, None)


_TESTS: Mapping[str, Callable[[RoadMap, World, Frame, int, Sequence[str]], bool]] = {
    "following": _following,
    "merging": _merging,
    "yielding": _yielding,
    "turning": _turning,
}
