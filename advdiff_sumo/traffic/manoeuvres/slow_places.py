"""Where vehicles are inserted for slow entries: they crawl beside the target's lane, or stand as at a kerb."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.scene import HEAVY_CLASSES, AgentClass
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN
from advdiff_sumo.maps.lanes import Lane, Link
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.repertoire import PULL_OUT
from advdiff_sumo.traffic.manoeuvres.required_braking import REACTION_S, TargetWay
from advdiff_sumo.traffic.manoeuvres.situation_view import NEAR_M, SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import (
    PULLS_OUT_MPS,
    SETS_OFF_MPS2,
    SLOWEST_MPS,
    entry_gap_m,
    kerb_side,
)
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, StagingMemory
from advdiff_sumo.traffic.manoeuvres.standing_traffic import StandingTraffic
from advdiff_sumo.traffic.manoeuvres.ways import Way, lane_at
from advdiff_sumo.traffic.planning.lanes_ahead import lane_ahead

_KERB_CLASSES: tuple[AgentClass, ...] = (AgentClass.BUS, AgentClass.TRUCK, AgentClass.CAR)
"""Classes of the vehicles at the kerb, in turn."""
_CRAWL_SHARES = (0.25, 0.35, 0.45, 0.55)
"""Shares of the target's speed at which a vehicle crawls, lowest first: the slower, the farther ahead it begins."""
SLOW_ENTRY_MIN_MPS = 6.0
"""For a slower target no vehicle is inserted to enter slowly."""
_SEEN_S, _FIRST_MERGE_S = 1.2, 3.5
"""Time from the insertion until the vehicle may begin; earliest time of a merge in an episode."""
_MERGES_S, _IN_VIEW_S = 1.0, 0.8
"""Time until a merging vehicle is over the line; time for which it must be in view before it begins."""
_ENTERS_S, _PERCEIVED_S, _TARGET_BRAKING_MPS2 = 1.5, 3.0, 3.5
"""When a vehicle that sets off is over the line; when it is in the target's corridor; how hard the target brakes."""
_MIN_AHEAD_M = 36.0
_CHANGE_ROOM_M = 20.0  # the road goes on for this distance beyond an inserted vehicle, for its lane change
_FREE_BEHIND_M, _FREE_AHEAD_M, _APART_M = 50.0, 15.0, 10.0  # free road around an inserted vehicle
_PAUSE_S = 15.0


def insert_slow_vehicle(
    view: SituationView, stage: StagingMemory, standing: StandingTraffic, kind: str
) -> tuple[StandingTraffic, StagingMemory]:
    """Return the vehicle that is inserted beside the target's lane for *kind*, if there is room, and the memory."""
    now = view.scene.time_s
    if standing.members or now < standing.next_try_s or stage.count >= stage.most:
        return standing, stage
    agent_class = _KERB_CLASSES[stage.count % len(_KERB_CLASSES)] if kind == PULL_OUT else stage.agent_class
    spare_m = stage.intensity.spare_gap_m or 0.0
    candidate = next(_candidates(view, kind, agent_class, spare_m), None)
    if candidate is None:
        return standing, stage
    vehicle = replace(candidate, name=f"staged-{stage.count}")
    return StandingTraffic(kind, (vehicle,), now, now + _PAUSE_S), replace(stage, count=stage.count + 1)


def can_insert_slow_vehicle(view: SituationView, kind: str) -> bool:
    """Return whether there is room for a vehicle that is to enter the target's lane slowly."""
    return next(_candidates(view, kind, AgentClass.CAR), None) is not None


def _candidates(
    view: SituationView, kind: str, agent_class: AgentClass, spare_m: float = 0.0
) -> Iterator[Newcomer]:
    """Yield vehicles that may be inserted beside the target's lane, the preferred ones first.

    They can begin with *spare_m* more than the gap that is demanded.
    """
    target = view.target
    if target is None or target.speed_mps < SLOW_ENTRY_MIN_MPS:
        return
    seen_s = _SEEN_S if kind == PULL_OUT else max(_FIRST_MERGE_S - view.scene.time_s, _SEEN_S)
    target_mps = _target_speed_at(view, target, seen_s, _PERCEIVED_S if kind == PULL_OUT else _MERGES_S)
    for speed_mps, begin_m in _begin_distances(view, target_mps, kind, agent_class, spare_m):
        ahead_m = begin_m + seen_s * (target_mps - speed_mps)
        yield from _beside(view, target, kind, agent_class, speed_mps, ahead_m)


def _target_speed_at(view: SituationView, target: TargetWay, seen_s: float, more_s: float) -> float:
    """Return the target's speed *seen_s* from now or, if it accelerates, the one that it may reach *more_s* later."""
    gain_mps = view.speed_gain_mps2(view.scene.target) * (seen_s + more_s)
    speed = float(np.interp(seen_s, FINE_TIMES_S, target.free_speed_mps))
    return max(speed, min(target.speed_mps + gain_mps, target.way.lane.speed_mps))


def _beside(
    view: SituationView,
    target: TargetWay,
    kind: str,
    agent_class: AgentClass,
    speed_mps: float,
    ahead_m: float,
) -> Iterator[Newcomer]:
    """Yield vehicles for the lanes beside the target's, at *speed_mps*, with centres *ahead_m* of the target's."""
    road_beyond_m = _CHANGE_ROOM_M + 0.5 * Newcomer.size_of(agent_class)[0]
    way = view.extended_way(target.way, ahead_m)
    target_lane, s = lane_at(way, way.lane.s_m + ahead_m)
    last_m = ahead_m + road_beyond_m
    must_wait = any(line_m < last_m and not _is_passable(view, link) for line_m, link in way.links)
    if must_wait or target_lane.is_internal or way.lane.end_m < last_m or not view.is_clear_to(ahead_m):
        return
    edges = tuple(lane.edge_id for lane in way.lane.lanes if not lane.is_internal)
    route = tuple(view.scene.routes[view.scene.target])
    # the target's route, for which the vehicle has to change lanes
    onward = route[route.index(target_lane.edge_id) :] if target_lane.edge_id in route else ()
    for lane in _lanes_beside(view, target_lane, kind):
        own_way = Way(lane_ahead(view.road.lanes, lane, min(s, lane.length_m), 0.0, edges))
        vehicle = Newcomer(own_way, min(speed_mps, lane.speed_mps), agent_class, onward=onward)
        if own_way.lane.end_m > road_beyond_m and _is_alone(view, vehicle):
            yield vehicle


def _is_passable(view: SituationView, link: Link) -> bool:
    """Return whether the target may drive over *link* now without yielding to another vehicle."""
    return view.signal(link) == PROTECTED_GREEN if link.tls_id is not None else not link.yields


def _begin_distances(
    view: SituationView, target_mps: float, kind: str, agent_class: AgentClass, spare_m: float
) -> Iterator[tuple[float, float]]:
    """Yield (speed, distance of its centre ahead of the target's) at which the vehicle may begin its entry."""
    half_lengths_m = 0.5 * float(view.size(view.scene.target)[0] + Newcomer.size_of(agent_class)[0])
    if kind == PULL_OUT:
        begins = [(0.0, _pull_out_gap_m(target_mps, SETS_OFF_MPS2[agent_class in HEAVY_CLASSES]))]
    else:
        speeds = [max(share * target_mps, SLOWEST_MPS) for share in _CRAWL_SHARES]
        begins = [(speed, entry_gap_m(target_mps, speed, speed, _MERGES_S)) for speed in speeds]
    for speed, gap_m in begins:
        in_view_m = _IN_VIEW_S * (target_mps - speed) if speed else 0.0
        begin_m = gap_m + spare_m + half_lengths_m
        if begin_m + in_view_m <= NEAR_M:
            yield speed, max(begin_m, _MIN_AHEAD_M)


def _pull_out_gap_m(target_mps: float, accel_mps2: float) -> float:
    """Return the bumper gap at which a standing vehicle sets off before a target at *target_mps*.

    It leaves the lawful gap at the line, and room to brake once the vehicle is in the target's corridor.
    """
    enters_mps, end_mps = accel_mps2 * _ENTERS_S, PULLS_OUT_MPS[1]
    lawful_m = entry_gap_m(target_mps, 0.5 * enters_mps, enters_mps, _ENTERS_S)
    brakes_s = _PERCEIVED_S + REACTION_S
    driven_m = end_mps * brakes_s - 0.5 * end_mps**2 / accel_mps2
    braking_m = 0.5 * max(target_mps - end_mps, 0.0) ** 2 / _TARGET_BRAKING_MPS2
    return max(lawful_m, brakes_s * target_mps - driven_m + braking_m)


def _lanes_beside(view: SituationView, lane: Lane, kind: str) -> Iterator[Lane]:
    """Yield the lanes beside *lane* on which a vehicle may be inserted for *kind*.

    To pull out, that is only the outermost one. To merge, a lane that ends is preferred, then the one towards the kerb.
    """
    lanes = view.road.lanes
    to_left = kerb_side(view) == "left"
    outer, inner = (lane.left_id, lane.right_id) if to_left else (lane.right_id, lane.left_id)
    names = (outer,) if kind == PULL_OUT else (outer, inner)
    beside = [lanes[name] for name in names if name is not None and lanes[name].is_drivable]
    if kind == PULL_OUT:
        farther = [neighbour.left_id if to_left else neighbour.right_id for neighbour in beside]
        beside = [
            neighbour
            for neighbour, name in zip(beside, farther, strict=True)
            if name is None or not lanes[name].is_drivable
        ]
    yield from sorted(beside, key=lambda neighbour: bool(neighbour.successors))


def _is_alone(view: SituationView, vehicle: Newcomer) -> bool:
    """Return whether no vehicle but the target is near *vehicle*, or would have to brake behind it on its lane."""
    history = view.scene.history
    others = np.array([row for row in view.ways if row != view.scene.target], dtype=np.int64)
    s, left = vehicle.way.line.project(history.xy_m[others, -1], extrapolate=True)
    ahead = s - vehicle.way.lane.s_m
    distance = np.linalg.norm(history.xy_m[others, -1] - vehicle.xy_m, axis=-1)
    is_on_lane = np.abs(left) < 0.5 * vehicle.way.present_lane.width_m
    is_in_way = is_on_lane & (ahead > -_FREE_BEHIND_M) & (ahead < _FREE_AHEAD_M)
    return not bool((is_in_way | (distance < _APART_M)).any())
