"""Decide in which situation a vehicle is when a scene starts, such as following, merging, yielding or turning."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.signal_letters import GREEN, RED, YELLOW
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.junction_priority import come_head_on, priority_links
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.sim.sim_options import Situation
from advdiff_sumo.sim.world import Frame, World

_FOLLOWING_S = 3.5  # longest headway of a follower
_BESIDE_M = 20.0  # longest distance along the lane between vehicles beside each other
_JUNCTION_M = 60.0  # longest distance to the next junction
_ONCOMING_FROM_M = 15.0  # shortest distance to a junction at which oncoming traffic is to be met
_REACTION_S, _COMFORTABLE_MPS2 = 1.0, 3.0  # with which a vehicle can stop as its light turns yellow
_AFTER_YELLOW_S = 3.0  # latest arrival at the line, after the end of the yellow light
SHORT_LIVED_S: Mapping[Situation, float] = {"yellow": 0.5, "lane-change": 0.5}
"""Situation that soon passes → time after which it is looked for again."""


@dataclass(frozen=True)
class SignalChange:
    """The next change of a traffic light.

    Attributes:
        state: state after it, a letter for each link.
        in_s: time until it.
        lasts_s: duration of the state after it.
    """

    state: str
    in_s: float
    lasts_s: float


@dataclass(frozen=True)
class Signals:
    """The traffic lights at an instant.

    Attributes:
        states: traffic light → its state, a letter for each link.
        changes: traffic light → its next change.
    """

    states: Mapping[str, str]
    changes: Mapping[str, SignalChange]


def in_situation(
    situation: Situation,
    road: RoadMap,
    world: World,
    frame: Frame,
    row: int,
    route: Sequence[str],
    signals: Signals,
) -> bool:
    """Return whether the vehicle in *row* is in *situation* in *frame*.

    Args:
        situation: "following": a vehicle is ahead in its lane, less than 3.5 s away at its own speed. "merging": a
            vehicle is on a lane beside it, within 20 m. "yielding": it is the first before a junction within 60 m, and
            must yield there. "turning": its route turns at that junction. "oncoming": it is the first before that
            junction, at least 15 m away, and must let oncoming traffic pass, which has no red light. "red-light": it
            is the first before that junction, and its signal is red. "yellow": it is the first there, and its green
            light turns yellow when it can still stop with 3 m/s² after 1 s, and red before it arrives at its speed.
            "lane-change": always, as :func:`~advdiff_sumo.sim.target_route.lane_change_route` decides.
            "any": always.
        road: the net.
        world: names and lanes of the rows.
        frame: the states.
        row: of the vehicle.
        route: its edges from the present one on.
        signals: the traffic lights; their next changes matter for "yellow" alone.
    """
    if situation in _LANE_TESTS:
        return _LANE_TESTS[situation](road, world, frame, row)
    if situation in _JUNCTION_TESTS:
        approach = _next_junction(road, world, frame, row, route)
        return approach is not None and _JUNCTION_TESTS[situation](road, approach, signals)
    return True


def gaps_along(road: RoadMap, world: World, frame: Frame, row: int, lane_id: str) -> list[float]:
    """Return the distances in m, along *lane_id*, from *row* to the vehicles on that lane; negative behind it."""
    line = road.lanes[lane_id].line
    own_s_m = float(line.project(frame.xy_m[row])[0])
    others = [k for k in np.flatnonzero(frame.present).tolist() if k != row and world.lane[k] == lane_id]
    return [float(line.project(frame.xy_m[k])[0]) - own_s_m for k in others]


def _following(road: RoadMap, world: World, frame: Frame, row: int) -> bool:
    range_m = max(_FOLLOWING_S * float(frame.speed_mps[row]), 10.0)
    return any(0.0 < gap_m < range_m for gap_m in gaps_along(road, world, frame, row, world.lane[row]))


def _merging(road: RoadMap, world: World, frame: Frame, row: int) -> bool:
    lane = road.lanes[world.lane[row]]
    neighbours = [name for name in (lane.left_id, lane.right_id) if name is not None]
    gaps_m = (gap_m for name in neighbours for gap_m in gaps_along(road, world, frame, row, name))
    return any(abs(gap_m) < _BESIDE_M for gap_m in gaps_m)


@dataclass(frozen=True)
class _Approach:
    """A vehicle before the next junction of its route.

    Attributes:
        link: its link over the junction.
        distance_m: from its centre to the stop line.
        speed_mps: its speed.
        is_first: whether no vehicle is ahead of it on its lane.
    """

    link: Link
    distance_m: float
    speed_mps: float
    is_first: bool


def _yielding(road: RoadMap, approach: _Approach, signals: Signals) -> bool:  # noqa: ARG001 - one signature for all tests
    return approach.is_first and bool(road.yields_to(approach.link))


def _turning(road: RoadMap, approach: _Approach, signals: Signals) -> bool:  # noqa: ARG001 - one signature for all tests
    return approach.link.direction.lower() in ("l", "r")


def _oncoming(road: RoadMap, approach: _Approach, signals: Signals) -> bool:
    link = approach.link
    if not approach.is_first or approach.distance_m < _ONCOMING_FROM_M or link.signal(signals.states) in RED:
        return False
    return any(come_head_on(road, link, other) for other in priority_links(road, link, signals.states))


def _red_light(road: RoadMap, approach: _Approach, signals: Signals) -> bool:  # noqa: ARG001 - one signature for all tests
    return approach.is_first and approach.link.signal(signals.states) in RED


def _yellow(road: RoadMap, approach: _Approach, signals: Signals) -> bool:  # noqa: ARG001 - one signature for all tests
    link, speed_mps = approach.link, approach.speed_mps
    light = link.tls_id or ""
    change = signals.changes.get(light)
    if change is None or not approach.is_first or speed_mps <= 0.0:
        return False
    if link.signal(signals.states) not in GREEN or link.signal({light: change.state}) not in YELLOW:
        return False
    red_s = change.in_s + change.lasts_s
    stops_within_m = _REACTION_S * speed_mps + speed_mps**2 / (2.0 * _COMFORTABLE_MPS2)
    can_stop = approach.distance_m - change.in_s * speed_mps >= stops_within_m
    return can_stop and red_s <= approach.distance_m / speed_mps <= red_s + _AFTER_YELLOW_S


def _next_junction(
    road: RoadMap, world: World, frame: Frame, row: int, route: Sequence[str]
) -> _Approach | None:
    """Return the approach of *row* to the next junction of its route; None if that is not near."""
    lane = road.lanes[world.lane[row]]
    distance_m = lane.length_m - float(lane.line.project(frame.xy_m[row])[0])
    if distance_m > _JUNCTION_M or len(route) < 2:
        return None
    links = (link for link in lane.successors if road.lanes[link.to_lane].edge_id == route[1])
    link = next(links, None)
    if link is None:
        return None
    is_first = max(gaps_along(road, world, frame, row, lane.id), default=0.0) <= 0.0
    return _Approach(link, distance_m, float(frame.speed_mps[row]), is_first)


_LANE_TESTS: Mapping[str, Callable[[RoadMap, World, Frame, int], bool]] = {
    "following": _following,
    "merging": _merging,
}
_JUNCTION_TESTS: Mapping[str, Callable[[RoadMap, _Approach, Signals], bool]] = {
    "yielding": _yielding,
    "turning": _turning,
    "oncoming": _oncoming,
    "red-light": _red_light,
    "yellow": _yellow,
}
