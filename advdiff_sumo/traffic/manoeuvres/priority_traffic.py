"""Where somebody has to be now to meet the target at a junction where the target has to let it pass."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.polylines import concatenate
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane, Link
from advdiff_sumo.traffic.manoeuvres.answers import REACTION_S, TargetWay
from advdiff_sumo.traffic.manoeuvres.free_speed import bend_mps
from advdiff_sumo.traffic.manoeuvres.intensity import MOST_EARLY_S
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.ways import Way

REACH_M = 80.0
"""Distance within which a junction ahead is looked at."""
SLOWEST_TARGET_MPS = 3.0
"""For a slower target nobody comes in, and nobody is timed to cross its way."""
_SOONEST_S, _LATEST_S, _RED_S = 3.2, 6.0, 5.0
_LEAST_ARRIVAL_S = 1.7
_SLOWEST_MPS, _FASTEST_MPS, _SHARE = 3.0, 12.0, 0.6
CAREFUL_STOP_MPS2 = 4.0
"""Braking with which a careful driver who sees somebody come in still stops at its line."""
_WAITS_BEFORE_M = 2.5
"""Before the middle of the other's lane: where who turns across it waits."""
_TIMING_S, _TIMING_AT_RED_S = (0.0, 0.7, -0.7), (0.5, 0.0, 1.0)
_PACE_AT_RED = 0.8
"""Share of the limit at which somebody comes who may have to hurry, or to hesitate."""
_TOUCHES_M, _BEYOND_M, _SPACING_M = 2.0, 6.0, 0.5
_FROM_LINE_M, _ONCOMING_RAD = 8.0, 2.2


@dataclass(frozen=True)
class Approach:
    """Somebody who would meet the target.

    Attributes:
        way: begins where it would be now.
        speed_mps: with which it would come.
    """

    way: Way
    speed_mps: float


def priority_approaches(
    view: SituationView, oncoming: bool, early_s: float | None = None, from_ahead_only: bool = False
) -> Iterator[Approach]:
    """Yield who would meet the target at its next junctions and goes first, those wanted most first.

    The target goes on as if it saw nobody. Nobody meets a target that waits behind others or hardly moves, nor one
    that is too near to give way: at its stop line, or before the place where it meets who comes from ahead.

    Args:
        view: the scene.
        oncoming: whether those who come from ahead are wanted more than those from the sides.
        early_s: how long before the target they are there; None: with it.
        from_ahead_only: whether nobody from the sides is wanted at all; those who turn come where none go straight
            on, as slow as their bend asks for.
    """
    target = view.target
    if target is None or target.speed_mps < SLOWEST_TARGET_MPS:
        return
    stops_m = _stops_m(target)
    for reach, link in target.way.links:
        if not 0.0 < reach < REACH_M or not view.is_clear_on_arrival(reach):
            return
        red = view.is_red(link)
        met = [
            (other, places)
            for other in _foes(view, link, oncoming, from_ahead_only)
            if (places := conflict_points_m(view.road, link, other))
            and stops_m <= reach + _waits_m(view, link, other, places[0])
        ]
        if red:
            met.sort(key=lambda one: one[1][1])  # who is soon there leaves the least time to see it coming
        for other, places in met:
            meets_s = target.arrival_s(reach + places[0])
            soonest_s = (
                _SOONEST_S if early_s is None else MOST_EARLY_S + _LEAST_ARRIVAL_S
            )  # room for every severity
            if soonest_s < meets_s < (_RED_S if red else _LATEST_S):
                usual_s = _TIMING_AT_RED_S if red else _TIMING_S
                timing_s = usual_s if early_s is None else (-early_s,)
                arrivals_s = [meets_s + late for late in timing_s]
                pace = _PACE_AT_RED if red else 1.0
                fastest_mps = turn_speed_mps(view.road, other) if from_ahead_only else np.inf
                yield from _meeting(view, other, arrivals_s, places[1], pace, fastest_mps)
        if red:
            return


def _foes(view: SituationView, link: Link, oncoming: bool, from_ahead_only: bool) -> list[Link]:
    """Return the links whose traffic goes first where *link* meets them, those wanted most first."""
    foes = sorted(priority_links(view, link), key=lambda one: _preference(view, link, one, oncoming))
    if not from_ahead_only:
        return foes
    ahead = [one for one in foes if is_oncoming(view, link, one)]
    return [one for one in ahead if one.direction == "s"] or ahead


def _stops_m(target: TargetWay) -> float:
    """Return how far ahead of its centre the front of a careful driver stops that sees cause to now."""
    return float(target.braked_motion((CAREFUL_STOP_MPS2,), REACTION_S)[0][0, -1]) + 0.5 * float(
        target.size_m[0]
    )


def _waits_m(view: SituationView, link: Link, other: Link, meets_m: float) -> float:
    """Return how far beyond its stop line somebody on *link* waits for *other*, which it would meet at *meets_m*."""
    return max(meets_m - _WAITS_BEFORE_M, 0.0) if is_oncoming(view, link, other) else 0.0


def priority_links(view: SituationView, link: Link) -> list[Link]:
    """Return the links whose traffic goes first where *link* meets them, and that may be driven now.

    That is who has the right of way over *link* or, while that has a red light, who has a green one.
    """
    junction = view.road.junctions[link.junction_id]
    lanes = (view.road.lanes.get(name) for name in junction.incoming_lanes)
    there = [lane for lane in lanes if lane is not None and lane.is_drivable and not lane.is_internal]
    others = (other for lane in there for other in lane.successors if other.junction_id == junction.id)
    if view.is_red(link):
        foes = junction.foes.get(link.request_index, frozenset())
        return [
            other for other in others if other.request_index in foes and view.signal(other) == PROTECTED_GREEN
        ]
    return [other for other in others if view.yields_to(link, other) and _may_go(view, other)]


def _may_go(view: SituationView, link: Link) -> bool:
    return view.signal(link) == PROTECTED_GREEN or (not view.signal(link) and not link.must_wait)


def _preference(view: SituationView, link: Link, other: Link, oncoming: bool) -> tuple[bool, bool]:
    return is_oncoming(view, link, other) is not oncoming, other.direction != "s"


def is_oncoming(view: SituationView, link: Link, other: Link) -> bool:
    """Return whether who takes *other* comes to the junction head-on to who takes *link*."""
    own, theirs = (
        float(view.road.lanes[name].line.segment_yaw_rad[-1]) for name in (link.from_lane, other.from_lane)
    )
    return abs(float(wrap_angle(own - theirs))) > _ONCOMING_RAD


@lru_cache(maxsize=4096)
def conflict_points_m(road: RoadMap, link: Link, other: Link) -> tuple[float, float] | None:
    """Return how far beyond their stop lines the centres of two vehicles meet; None where they stay apart."""
    own, theirs = _over(road, link), _over(road, other)
    apart = np.hypot(*(own[:, None] - theirs[None]).transpose(2, 0, 1))
    near = apart.min(axis=1) < _TOUCHES_M
    if not near.any():
        return None
    rows = np.flatnonzero(near)
    row = rows[0] if link.to_lane == other.to_lane else rows[len(rows) // 2]
    return _SPACING_M * float(row), _SPACING_M * float(apart[row].argmin())


def _over(road: RoadMap, link: Link) -> FloatArray:
    """Return points every half metre from the stop line to a little beyond the junction."""
    line = concatenate([road.lanes[name].line for name in (*link.via, link.to_lane)])
    inside = sum(road.lanes[name].length_m for name in link.via)
    return line.at(np.arange(0.0, min(inside + _BEYOND_M, line.length_m), _SPACING_M))[0]


def turn_speed_mps(road: RoadMap, link: Link) -> float:
    """Return the speed that the junction's lanes of *link* allow who takes it: their limits and bends."""
    lanes = [road.lanes[name] for name in link.via]
    return min((min(lane.speed_mps, bend_mps(lane)) for lane in lanes), default=np.inf)


def _meeting(
    view: SituationView,
    link: Link,
    arrivals_s: Sequence[float],
    beyond_m: float,
    pace: float,
    fastest_mps: float,
) -> Iterator[Approach]:
    """Yield who is *beyond_m* beyond the stop line of *link* at one of *arrivals_s*, at a *pace* of the limit."""
    limit = min(pace * min(view.road.lanes[link.from_lane].speed_mps, _FASTEST_MPS / pace), fastest_mps)
    upstream = _upstream(view, link)
    room = sum(lane.length_m for lane in upstream)
    for arrives_s in arrivals_s:
        away = min(limit * arrives_s - beyond_m, room - 1.0)
        speed = (away + beyond_m) / max(arrives_s, 0.1)
        if away < _FROM_LINE_M or speed < max(_SHARE * limit, _SLOWEST_MPS):
            continue
        way = _way(view, upstream, link, away)
        if way is not None and link in (one for _, one in way.links):
            yield Approach(way, min(speed, limit))


def _upstream(view: SituationView, link: Link) -> list[Lane]:
    """Return the lanes that lead straight to *link* by right of way, its own first, internal ones included."""
    lanes = view.road.lanes
    out = [lanes[link.from_lane]]
    into = _into(view.road)
    while sum(lane.length_m for lane in out) < REACH_M:
        before = into.get(out[-1].id)
        if before is None or before.yields or view.signal(before) not in ("", PROTECTED_GREEN):
            break
        out += [*(lanes[name] for name in reversed(before.via)), lanes[before.from_lane]]
    return out


def _way(view: SituationView, upstream: Sequence[Lane], link: Link, away_m: float) -> Way | None:
    """Return the way over *link* from *away_m* before its stop line, on *upstream*; None on a junction."""
    edges, left = [view.road.lanes[link.to_lane].edge_id], away_m
    for lane in upstream:
        if not lane.is_internal:
            edges.append(lane.edge_id)
        if left < lane.length_m:
            return (
                None if lane.is_internal else view.way_from(lane.line.at(lane.length_m - left), edges[::-1])
            )
        left -= lane.length_m
    return None


@lru_cache(maxsize=4)
def _into(road: RoadMap) -> Mapping[str, Link]:
    """Return lane → the link that leads straight into it."""
    return {link.to_lane: link for link in road.links.values() if link.direction == "s"}
