"""Decide whether a vehicle is following, merging, yielding, turning, or before a red light when a scene starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from advdiff_sumo.core.signal_letters import RED
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.sim.sim_options import Situation
from advdiff_sumo.sim.world import Frame, World

_FOLLOWING_S = 3.5  # longest headway of a follower
_BESIDE_M = 20.0  # longest distance along the lane between vehicles beside each other
_JUNCTION_M = 60.0  # longest distance to the next junction


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
        situation: "following": a vehicle is ahead in its lane, less than 3.5 s away at its own speed. "merging": a
            vehicle is on a lane beside it, within 20 m. "yielding": it is the first before a junction within 60 m, and
            must yield there. "turning": its route turns at that junction. "red-light": it is the first before that
            junction, and its signal is red. "any": always.
        road: the net.
        world: names and lanes of the rows.
        frame: the states.
        row: of the vehicle.
        route: its edges from the present one on.
        signals: state of every traffic light.
    """
    if situation == "red-light":
        link = _next_link(road, world, frame, row, route)
        return link is not None and link.signal(signals) in RED and _is_first(road, world, frame, row)
    return situation == "any" or _TESTS[situation](road, world, frame, row, route)


def _gaps_along(road: RoadMap, world: World, frame: Frame, row: int, lane_id: str) -> list[float]:
    """Return the distances in m, along *lane_id*, from *row* to the vehicles on that lane; negative behind it."""
    line = road.lanes[lane_id].line
    own_s_m = float(line.project(frame.xy_m[row])[0])
    others = [k for k in np.flatnonzero(frame.present).tolist() if k != row and world.lane[k] == lane_id]
    return [float(line.project(frame.xy_m[k])[0]) - own_s_m for k in others]


def _following(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> bool:  # noqa: ARG001 - one signature for all tests
    range_m = max(_FOLLOWING_S * float(frame.speed_mps[row]), 10.0)
    return any(0.0 < gap_m < range_m for gap_m in _gaps_along(road, world, frame, row, world.lane[row]))


def _merging(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> bool:  # noqa: ARG001 - one signature for all tests
    lane = road.lanes[world.lane[row]]
    neighbours = [name for name in (lane.left_id, lane.right_id) if name is not None]
    gaps_m = (gap_m for name in neighbours for gap_m in _gaps_along(road, world, frame, row, name))
    return any(abs(gap_m) < _BESIDE_M for gap_m in gaps_m)


def _yielding(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> bool:
    """Return whether *row* is the first before a junction at which it must yield."""
    link = _next_link(road, world, frame, row, route)
    return link is not None and _is_first(road, world, frame, row) and bool(road.yields_to(link))


def _is_first(road: RoadMap, world: World, frame: Frame, row: int) -> bool:
    """Return whether no vehicle is ahead of *row* on its lane."""
    return max(_gaps_along(road, world, frame, row, world.lane[row]), default=0.0) <= 0.0


def _turning(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> bool:
    link = _next_link(road, world, frame, row, route)
    return link is not None and link.direction.lower() in ("l", "r")


def _next_link(road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]) -> Link | None:
    """Return the link of the route over the next junction; None if that is not near."""
    lane = road.lanes[world.lane[row]]
    remaining_m = lane.length_m - float(lane.line.project(frame.xy_m[row])[0])
    if remaining_m > _JUNCTION_M or len(route) < 2:
        return None
    links = (link for link in lane.successors if road.lanes[link.to_lane].edge_id == route[1])
    return next(links, None)


_TESTS: Mapping[str, Callable[[RoadMap, World, Frame, int, Sequence[str]], bool]] = {
    "following": _following,
    "merging": _merging,
    "yielding": _yielding,
    "turning": _turning,
}
