"""Where somebody comes in who is to enter the target's lane slowly: it crawls beside it, or stands as at a kerb."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.scene import HEAVY_CLASSES, AgentClass
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN
from advdiff_sumo.maps.lanes import Lane, Link
from advdiff_sumo.traffic.manoeuvres.answers import REACTION_S, TargetWay
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.repertoire import PULL_OUT
from advdiff_sumo.traffic.manoeuvres.situation_view import NEAR_M, SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import (
    PULLS_OUT_MPS,
    SETS_OFF_MPS2,
    SLOWEST_MPS,
    entry_gap_m,
    kerb_side,
)
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, StagingMemory
from advdiff_sumo.traffic.manoeuvres.standing_traffic import StandingTraffic, lane_at
from advdiff_sumo.traffic.manoeuvres.ways import Way
from advdiff_sumo.traffic.planning.lanes_ahead import lane_ahead

_STANDS: tuple[AgentClass, ...] = (AgentClass.BUS, AgentClass.TRUCK, AgentClass.CAR)
"""Who stands at the kerb first, second, …; in turn."""
_CRAWLS_SHARES = (0.25, 0.35, 0.45, 0.55)
"""Shares of the target's speed at which somebody crawls, the slowest first; the slower, the farther off it begins."""
_LEAST_TARGET_MPS = 6.0
_SEEN_S, _AT_FIRST_S = 1.2, 3.5
"""For so long the target drives towards who has come in before that one may begin; as long at first who merges."""
_MERGES_S, _IN_VIEW_S = 1.0, 0.8
_ENTERS_S, _PERCEIVED_S, _ANSWER_MPS2 = 1.5, 3.0, 3.5
"""When somebody who sets off is over the line, and in the target's corridor, and what that then answers with."""
_LEAST_AHEAD_M = 36.0
_GOES_ON_M = 20.0
"""So far beyond who comes in the road goes on, to change lanes on."""
_FREE_BEHIND_M, _FREE_AHEAD_M, _APART_M = 50.0, 15.0, 10.0
_AGAIN_S = 15.0


def insert_slow_vehicle(
    view: SituationView, stage: StagingMemory, standing: StandingTraffic, kind: str
) -> tuple[StandingTraffic, StagingMemory]:
    """Return who comes in now beside the target's lane for *kind*, if there is room, and what staging remembers."""
    now = view.scene.time_s
    if standing.members or now < standing.next_try_s or stage.count >= stage.most:
        return standing, stage
    agent_class = _STANDS[stage.count % len(_STANDS)] if kind == PULL_OUT else stage.agent_class
    place = next(_places(view, kind, agent_class), None)
    if place is None:
        return standing, stage
    one = replace(place, name=f"staged-{stage.count}")
    return StandingTraffic(kind, (one,), now, now + _AGAIN_S), replace(stage, count=stage.count + 1)


def can_insert_slow_vehicle(view: SituationView, kind: str) -> bool:
    """Return whether there is room for somebody who is to enter the target's lane slowly."""
    return next(_places(view, kind, AgentClass.CAR), None) is not None


def _places(view: SituationView, kind: str, agent_class: AgentClass) -> Iterator[Newcomer]:
    """Yield where somebody may come in beside the target's lane, those wanted most first."""
    target = view.target
    if target is None or target.speed_mps < _LEAST_TARGET_MPS:
        return
    seen_s = _SEEN_S if kind == PULL_OUT else max(_AT_FIRST_S - view.scene.time_s, _SEEN_S)
    speed = _speed_then(view, target, seen_s, _PERCEIVED_S if kind == PULL_OUT else _MERGES_S)
    for drives, ahead in _distances(view, speed, kind, agent_class):
        yield from _beside(view, target, kind, agent_class, drives, ahead + seen_s * (speed - drives))


def _speed_then(view: SituationView, target: TargetWay, seen_s: float, then_s: float) -> float:
    """Return the speed of the target in *seen_s*, or, while it gains speed, the one that it may have *then_s* later."""
    gains = view.speed_gain_mps2(view.scene.target) * (seen_s + then_s)
    speed = float(np.interp(seen_s, FINE_TIMES_S, target.free_speed_mps))
    return max(speed, min(target.speed_mps + gains, target.way.lane.speed_mps))


def _beside(
    view: SituationView,
    target: TargetWay,
    kind: str,
    agent_class: AgentClass,
    speed_mps: float,
    ahead_m: float,
) -> Iterator[Newcomer]:
    """Yield who may come in beside the target's lane at *speed_mps*, its centre *ahead_m* of the target's."""
    goes_on = _GOES_ON_M + 0.5 * Newcomer.size_of(agent_class)[0]
    way = view.extended_way(target.way, ahead_m)
    there, s = lane_at(way, way.lane.s_m + ahead_m)
    waits = any(reach < ahead_m + goes_on and not _is_free(view, link) for reach, link in way.links)
    if waits or there.is_internal or way.lane.end_m < ahead_m + goes_on or not view.is_clear_to(ahead_m):
        return
    edges = tuple(one.edge_id for one in way.lane.lanes if not one.is_internal)
    route = tuple(view.scene.routes[view.scene.target])
    onward = route[route.index(there.edge_id) :] if there.edge_id in route else ()  # it has to change lanes
    for lane in _lanes_beside(view, there, kind):
        on = Way(lane_ahead(view.road.lanes, lane, min(s, lane.length_m), 0.0, edges))
        one = Newcomer(on, min(speed_mps, lane.speed_mps), agent_class, onward=onward)
        if on.lane.end_m > goes_on and _is_alone(view, one):
            yield one


def _is_free(view: SituationView, link: Link) -> bool:
    """Return whether a target may drive over *link* as it is now, and waits for nobody."""
    return view.signal(link) == PROTECTED_GREEN if link.tls_id is not None else not link.yields


def _distances(
    view: SituationView, speed_mps: float, kind: str, agent_class: AgentClass
) -> Iterator[tuple[float, float]]:
    """Yield speeds of who comes in, and how far ahead of a target at *speed_mps* its centre is when it begins."""
    lengths = 0.5 * float(view.size(view.scene.target)[0] + Newcomer.size_of(agent_class)[0])
    if kind == PULL_OUT:
        begins = [(0.0, _pulls_out_m(speed_mps, SETS_OFF_MPS2[agent_class in HEAVY_CLASSES]))]
    else:
        crawls = [max(share * speed_mps, SLOWEST_MPS) for share in _CRAWLS_SHARES]
        begins = [(one, entry_gap_m(speed_mps, one, one, _MERGES_S)) for one in crawls]
    for drives, gap in begins:
        in_view_m = _IN_VIEW_S * (speed_mps - drives) if drives else 0.0
        if gap + lengths + in_view_m <= NEAR_M:
            yield drives, max(gap + lengths, _LEAST_AHEAD_M)


def _pulls_out_m(speed_mps: float, gains_mps2: float) -> float:
    """Return the bumper gap at which somebody who stands sets off before a target at *speed_mps*.

    It leaves the lawful gap at the line, and room to answer once it is in the target's corridor.
    """
    enters, drives = gains_mps2 * _ENTERS_S, PULLS_OUT_MPS[1]
    lawful_m = entry_gap_m(speed_mps, 0.5 * enters, enters, _ENTERS_S)
    answers_s = _PERCEIVED_S + REACTION_S
    driven_m = drives * answers_s - 0.5 * drives**2 / gains_mps2
    needs_m = answers_s * speed_mps - driven_m + 0.5 * max(speed_mps - drives, 0.0) ** 2 / _ANSWER_MPS2
    return max(lawful_m, needs_m)


def _lanes_beside(view: SituationView, lane: Lane, kind: str) -> Iterator[Lane]:
    """Yield the lanes beside *lane* on which somebody may come in for *kind*.

    For who pulls out that is the outermost; for who merges one that ends is wanted most, then the one to the kerb.
    """
    lanes = view.road.lanes
    outer, inner = (
        (lane.left_id, lane.right_id) if kerb_side(view) == "left" else (lane.right_id, lane.left_id)
    )
    names = (outer,) if kind == PULL_OUT else (outer, inner)
    there = [lanes[name] for name in names if name is not None and lanes[name].is_drivable]
    if kind == PULL_OUT:
        beyond = [one.left_id if kerb_side(view) == "left" else one.right_id for one in there]
        there = [
            one
            for one, name in zip(there, beyond, strict=True)
            if name is None or not lanes[name].is_drivable
        ]
    yield from sorted(there, key=lambda one: bool(one.successors))


def _is_alone(view: SituationView, one: Newcomer) -> bool:
    """Return whether nobody but the target is near *one* on its lane, who would have to brake behind it."""
    now = view.scene.history
    others = np.array([row for row in view.ways if row != view.scene.target], dtype=np.int64)
    s, left = one.way.line.project(now.xy_m[others, -1], extrapolate=True)
    ahead, apart = s - one.way.lane.s_m, np.linalg.norm(now.xy_m[others, -1] - one.xy_m, axis=-1)
    on_lane = np.abs(left) < 0.5 * one.way.present_lane.width_m
    meets = on_lane & (ahead > -_FREE_BEHIND_M) & (ahead < _FREE_AHEAD_M)
    return not bool((meets | (apart < _APART_M)).any())
