"""Staging: inserts vehicles that an encounter lacks, as traffic that arrives from farther away.

At the first plan of an episode nobody has seen anybody, so vehicles may be inserted nearer than later on.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.plan import AttackState, JointPlan
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.signal_letters import PLAIN_YELLOW, RED
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.licence import LAWFUL
from advdiff_sumo.traffic.manoeuvres.close_pass import pass_sides, passing_rows
from advdiff_sumo.traffic.manoeuvres.company import company_places, insertion_places
from advdiff_sumo.traffic.manoeuvres.intensity import ANY_SEVERITY, Intensity
from advdiff_sumo.traffic.manoeuvres.priority_traffic import (
    SLOWEST_TARGET_MPS,
    Approach,
    next_of_stream,
    priority_approaches,
)
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    BESIDE_KINDS,
    DOUBLE,
    HEADWAY_S,
    MIN_STOPPING_SPEED_MPS,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import ROAD_BEYOND_M, SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, PLAN_DT_S, PLAN_STEPS
from advdiff_sumo.traffic.manoeuvres.ways import Way, lane_at
from advdiff_sumo.traffic.planning.lanes_ahead import lane_ahead

SIZE_M = {AgentClass.CAR: (4.6, 1.8), AgentClass.TRUCK: (9.0, 2.4), AgentClass.MOTORCYCLE: (2.2, 0.8)}
"""Length and width of inserted vehicles."""
BUS_SIZE_M = (12.0, 2.5)
"""The same of a bus, which is inserted only at a kerb."""
DEFAULT_MAX_INSERTED = 6
"""Default of the most vehicles that are inserted during an episode."""
_PAUSE_S = 2.0  # after an insertion
_NO_PLACE_BEFORE = RED | {PLAIN_YELLOW}
"""Signals shortly before which no vehicle is inserted."""
NO_LEADER_WITHIN_M = 55.0
"""Distance within which the target must have no leader if a vehicle is to be inserted ahead."""
_LATER_LEADER_M, _FARTHEST_M = 36.0, 72.0
"""Nearest place of a leader after the first plan; farthest place of all."""
_NEAREST_AHEAD_M, _SPARE_M, _NEARLY_M = 22.0, 3.0, 10.0
"""Nearest place ahead at the first plan; spare gap beside; a vehicle this near to its place gets there by itself."""
_LEADER_SHIFTS_M = (0.0, 5.0, 10.0, 15.0)  # of a leader's place, in company
_APART_M, _APART_S = 9.0, 0.6  # least distance to others on the lane: constant part, and per m/s
_FROM_TARGET_M, _LATER_FROM_TARGET_M = 18.0, 30.0  # least distance to the target at the first plan, and later
_IN_LANE_M, _BESIDE_M = 2.0, 6.0  # lateral offset on a lane; least distance to vehicles on other lanes
_CLEAR_FOR_S, _CLEAR_M = 4.0, 3.0  # for so long an inserted vehicle stays so far from all others
_MIN_HIDING_M = 18.5  # least distance of a leader that hides a standing or slow vehicle
_MAX_CLOSING_MPS = 17.0
"""A faster target closes in on a slow vehicle at this speed, in place of a standing one."""
_HIDDEN_S = 5.0  # time in which the leader would reach the hidden vehicle
HIDDEN_LASTS_S = 20.0
"""A slow hidden vehicle keeps its speed for so long, for which its way must be free of lights and duties to yield."""


@dataclass(frozen=True)
class StagingMemory:
    """What staging remembers.

    Attributes:
        most: most vehicles that may be inserted during an episode.
        classes: classes of the inserted vehicles, in turn.
        oncoming: whether vehicles with priority come from ahead rather than from the side.
        only_oncoming: whether no vehicle with priority comes from the side.
        streams: whether further vehicles with priority follow the first one at short gaps.
        intensity: prescribed severities.
        count: number of vehicles inserted so far.
        next_try_s: when the next insertion may be tried.
    """

    most: int = 0
    classes: tuple[AgentClass, ...] = (AgentClass.CAR,)
    oncoming: bool = False
    only_oncoming: bool = False
    streams: bool = False
    intensity: Intensity = ANY_SEVERITY
    count: int = 0
    next_try_s: float = 0.0

    @property
    def agent_class(self) -> AgentClass:
        """Class of the vehicle that is inserted next."""
        return self.classes[self.count % len(self.classes)]


@dataclass(frozen=True)
class Newcomer(Approach):
    """A vehicle that is inserted; its way begins where it is now.

    Attributes:
        agent_class: its class.
        name: its id, once its insertion is certain.
        onward: edges of its route; (): those of its way.
        is_hidden: whether it stands, or is slow, ahead of a leader that hides it from the target.
    """

    agent_class: AgentClass = AgentClass.CAR
    name: str = ""
    onward: tuple[str, ...] = ()
    is_hidden: bool = False

    @staticmethod
    def size_of(agent_class: AgentClass) -> tuple[float, float]:
        """Return length and width of an inserted vehicle of *agent_class*."""
        return BUS_SIZE_M if agent_class is AgentClass.BUS else SIZE_M[agent_class]

    @property
    def xy_m(self) -> FloatArray:
        """Its (2,) centre now."""
        return self.way.line.at(self.way.lane.s_m)[0]

    @property
    def route(self) -> tuple[str, ...]:
        """The edges that it drives."""
        return self.onward or tuple(
            dict.fromkeys(lane.edge_id for lane in self.way.lane.lanes if not lane.is_internal)
        )


def insert_newcomers(
    view: SituationView, stage: StagingMemory, kinds: Container[str]
) -> tuple[tuple[Newcomer, ...], StagingMemory]:
    """Return the vehicles that are inserted now for manoeuvres of *kinds*, and the updated memory."""
    now = view.scene.time_s
    if view.target is None or stage.count >= stage.most or now < stage.next_try_s:
        return (), stage
    taken: list[Newcomer] = []
    roles = {
        "hard-stop": _leaders(view, stage),
        "cut-in": _neighbours(view, stage),
        "crossing": _with_priority(view, stage),
    }
    for candidates in (newcomers for kind, newcomers in roles.items() if kind in kinds):
        room = min(1, stage.most - stage.count - len(taken))
        taken += islice((newcomer for newcomer in candidates if _is_free(view, newcomer, taken)), room)
    if any(kind in kinds for kind in BESIDE_KINDS):
        taken += _leader_and_passing(view, stage)
    if DOUBLE in kinds:
        taken += _leader_and_company(view, stage)
    if "cut-out" in kinds and not taken and stage.most - stage.count >= 2:
        taken += _leader_and_hidden(view, stage)
    named = tuple(replace(newcomer, name=f"staged-{stage.count + k}") for k, newcomer in enumerate(taken))
    pause_s = _PAUSE_S if taken else 0.0  # the time at which a vehicle would meet the target is short
    return named, replace(stage, count=stage.count + len(taken), next_try_s=now + pause_s)


def plan_with(tracks: Tracks, newcomers: Sequence[Newcomer], attack: AttackState | None = None) -> JointPlan:
    """Return the plan of *tracks* and of *newcomers*, which follow their ways at constant speed.

    Args:
        tracks: at ``PLAN_DT_S``, or empty.
        newcomers: the inserted vehicles.
        attack: state of the attack.
    """
    times_s = PLAN_DT_S * np.arange(1.0, PLAN_STEPS + 1.0)
    poses = [newcomer.way.poses(newcomer.speed_mps * times_s, times_s) for newcomer in newcomers]
    return with_newcomers(JointPlan(tracks, attack=attack), newcomers, poses)


def with_newcomers(
    plan: JointPlan, newcomers: Sequence[Newcomer], poses: Sequence[tuple[FloatArray, FloatArray]]
) -> JointPlan:
    """Return *plan* with *newcomers* at centres (T, 2) and headings (T,) each, as long as its tracks, if it has any."""
    if not newcomers:
        return plan
    tracks = plan.tracks
    yaw = np.stack([headings for _, headings in poses])
    added = Tracks(
        ids=tuple(newcomer.name for newcomer in newcomers),
        classes=np.array([int(newcomer.agent_class) for newcomer in newcomers]),
        size_m=np.array([Newcomer.size_of(newcomer.agent_class) for newcomer in newcomers]),
        xy_m=np.stack([xy for xy, _ in poses]),
        yaw_rad=yaw,
        speed_mps=np.repeat([[newcomer.speed_mps] for newcomer in newcomers], yaw.shape[1], axis=1),
        valid=np.ones(yaw.shape, dtype=np.bool_),
        t0_s=tracks.t0_s,
        dt_s=PLAN_DT_S,
    )
    routes = {**plan.routes, **{newcomer.name: newcomer.route for newcomer in newcomers}}
    return replace(plan, tracks=tracks.joined(added) if tracks.agents else added, routes=routes)


def is_first_plan(view: SituationView) -> bool:
    """Return whether this is the first plan of an episode."""
    return view.scene.time_s < PLAN_DT_S


def _leaders(view: SituationView, stage: StagingMemory, more_m: float = 0.0) -> Iterator[Newcomer]:
    """Yield a leader for a target without one, *more_m* farther ahead than a leader keeps."""
    target = view.target
    if (
        target is None
        or target.speed_mps < SLOWEST_TARGET_MPS
        or view.is_occupied(target.way, NO_LEADER_WITHIN_M, _IN_LANE_M)
    ):
        return
    nearest_m = _NEAREST_AHEAD_M if is_first_plan(view) else _LATER_LEADER_M
    ahead_m = max(HEADWAY_S * target.speed_mps + 8.0, nearest_m) + more_m
    yield from _on_way(view, target.way, ahead_m, target.speed_mps, stage.agent_class)


def _neighbours(view: SituationView, stage: StagingMemory) -> Iterator[Newcomer]:
    """Yield vehicles on the next lanes, ahead of the target by the gap that a lane change must leave."""
    target = view.target
    if target is None or target.speed_mps < SLOWEST_TARGET_MPS or not view.is_clear_to(NO_LEADER_WITHIN_M):
        return
    target_mps = target.speed_mps + view.speed_gain_mps2(view.scene.target)
    nearest_m = _NEAREST_AHEAD_M if is_first_plan(view) else _LATER_FROM_TARGET_M + 1.0
    for side in ("left", "right"):
        way = view.neighbour_way(view.scene.target, side)
        if way is None:
            continue
        speed_mps = min(target.speed_mps, way.lane.speed_mps)
        safe_m = safe_gap_m(target_mps + 0.5, speed_mps)
        gap_m = LAWFUL.gap_share * safe_m + LAWFUL.spare_m + (stage.intensity.spare_gap_m or 0.0)
        ahead_m = max(gap_m + SIZE_M[stage.agent_class][0] + _SPARE_M, nearest_m)
        # a vehicle that is already near that place can get there by itself
        if not view.is_occupied(way, NO_LEADER_WITHIN_M, _IN_LANE_M, ahead_m - _NEARLY_M):
            yield from _on_way(view, way, ahead_m, speed_mps, stage.agent_class)


def _with_priority(view: SituationView, stage: StagingMemory) -> Iterator[Newcomer]:
    """Yield vehicles that the target must let pass at its next junction, where they arrive when it does.

    Those of a stream arrive shortly after one another.
    """
    last = view.scene.history.index.get(f"staged-{stage.count - 1}") if stage.streams else None
    if last is not None:
        for approach in next_of_stream(view, last):
            yield Newcomer(approach.way, approach.speed_mps, stage.agent_class)
        return
    early_s = stage.intensity.early_s
    for approach in priority_approaches(view, stage.oncoming, early_s, stage.only_oncoming):
        yield Newcomer(approach.way, approach.speed_mps, stage.agent_class)


def _leader_and_company(view: SituationView, stage: StagingMemory) -> list[Newcomer]:
    """Return a leader, and vehicles beside and behind the target, as far as they are missing."""
    company: list[Newcomer] = []
    most = stage.most - stage.count - 1
    for newcomer in _missing_company(view):
        if len(company) < most and _is_free(view, newcomer, ()) and _is_apart(newcomer, company):
            company.append(newcomer)
    shifts_m = _LEADER_SHIFTS_M if company_places(view) else ()
    leaders = (newcomer for more_m in shifts_m for newcomer in _leaders(view, stage, more_m))
    free_leaders = (
        newcomer for newcomer in leaders if _is_free(view, newcomer, ()) and _is_apart(newcomer, company)
    )
    return [*islice(free_leaders, 1), *company] if most >= 0 else []


def _leader_and_passing(view: SituationView, stage: StagingMemory) -> list[Newcomer]:
    """Return a leader, and a vehicle that comes to pass the target on the lane beside, as far as they are missing."""
    taken: list[Newcomer] = []
    candidates = (*_passing(view, stage), *_leaders(view, stage)) if pass_sides(view) else ()
    for newcomer in candidates:
        if len(taken) < stage.most - stage.count and _is_free(view, newcomer, taken):
            taken.append(newcomer)
    return taken


def _passing(view: SituationView, stage: StagingMemory) -> Iterator[Newcomer]:
    """Yield a vehicle on the lane beside: behind the target or, where the lane begins later, ahead of it."""
    target = view.target
    if target is None or target.speed_mps < MIN_STOPPING_SPEED_MPS or passing_rows(view):
        return
    nearest_m = _least_distance_m(view) + 1.0
    for side in pass_sides(view)[:1]:
        way = view.neighbour_way(view.scene.target, side)
        if way is not None:
            ahead_m = -nearest_m if way.lane.s_m > nearest_m else nearest_m
            yield from _on_way(
                view, way, ahead_m, min(target.speed_mps, way.lane.speed_mps), stage.agent_class
            )


def _is_apart(newcomer: Newcomer, taken: Sequence[Newcomer]) -> bool:
    """Return whether *newcomer* keeps its distance to those *taken* already."""
    return all(float(np.linalg.norm(newcomer.xy_m - other.xy_m)) > _BESIDE_M for other in taken)


def _missing_company(view: SituationView) -> Iterator[Newcomer]:
    """Yield cars for the places of the company, beside and behind the target, that nobody takes yet."""
    target, row = view.target, view.scene.target
    if target is None or target.speed_mps < MIN_STOPPING_SPEED_MPS:
        return
    nearest_m = _least_distance_m(view) + 1.0
    for side, ahead_m in insertion_places(view, nearest_m):
        way = view.neighbour_way(row, side) if side else target.way
        if way is not None and way.lane.s_m + ahead_m > 0.0:
            speed_mps = min(target.speed_mps, way.lane.speed_mps)
            yield from _on_way(view, way, ahead_m, speed_mps, AgentClass.CAR)


def can_insert_cut_out(view: SituationView) -> bool:
    """Return whether a standing or slow vehicle, and a leader before it, could be inserted now."""
    return bool(_leader_and_hidden(view, StagingMemory()))


def _leader_and_hidden(view: SituationView, stage: StagingMemory) -> Sequence[Newcomer]:
    """Return a leader and a vehicle ahead that it hides, if there is a free lane for the leader to change to."""
    target = view.target
    if target is None or not is_first_plan(view) or view.is_occupied(target.way, _FARTHEST_M, _IN_LANE_M):
        return ()
    neighbours = [view.neighbour_way(view.scene.target, side) for side in ("left", "right")]
    if not any(way is not None and not view.is_occupied(way, _FARTHEST_M, _IN_LANE_M) for way in neighbours):
        return ()
    speed = target.speed_mps
    if speed < SLOWEST_TARGET_MPS:
        return ()
    leader_m = max(HEADWAY_S * speed + SIZE_M[AgentClass.CAR][0], _MIN_HIDING_M)
    hidden_m = leader_m + _HIDDEN_S * min(speed, _MAX_CLOSING_MPS) + SIZE_M[AgentClass.TRUCK][0]
    leaders = _on_way(view, target.way, leader_m, speed, AgentClass.CAR)
    leader = [newcomer for newcomer in leaders if _is_free(view, newcomer, ())]
    hidden = list(_hidden(view, target.way, hidden_m, max(speed - _MAX_CLOSING_MPS, 0.0), stage.agent_class))
    return [*leader, *hidden] if leader and hidden and _meets_nobody(view, hidden[0]) else ()


def _hidden(
    view: SituationView, way: Way, ahead_m: float, speed_mps: float, agent_class: AgentClass
) -> Iterator[Newcomer]:
    """Yield a vehicle *ahead_m* further along *way* that stands or, undisturbed for ``HIDDEN_LASTS_S``, is slow."""
    drives_m = HIDDEN_LASTS_S * speed_mps
    way = view.extended_way(way, ahead_m + drives_m)
    for newcomer in _on_way(view, way, ahead_m, speed_mps, agent_class):
        if not speed_mps:
            yield replace(newcomer, is_hidden=True)
        elif drives_m + ahead_m < way.lane.end_m and not has_line_within(way, ahead_m + drives_m):
            lane, s_m = lane_at(way, way.lane.s_m + ahead_m)
            slow_way = Way(lane_ahead(view.road.lanes, lane, s_m, 0.0, newcomer.route, drives_m))
            yield replace(newcomer, way=slow_way, is_hidden=True)


def has_line_within(way: Way, reach_m: float) -> bool:
    """Return whether there is a light or a duty to yield on *way* within *reach_m*."""
    return any(line_m < reach_m and (link.yields or link.tls_id is not None) for line_m, link in way.links)


def _on_way(
    view: SituationView, way: Way, ahead_m: float, speed_mps: float, agent_class: AgentClass
) -> Iterator[Newcomer]:
    """Yield a vehicle *ahead_m* further along *way*: on no junction, before no red light, and not at the road's end."""
    if ahead_m + ROAD_BEYOND_M > way.lane.end_m:
        return
    if any(line_m < ahead_m + 10.0 and view.signal(link) in _NO_PLACE_BEFORE for line_m, link in way.links):
        return
    pose = way.line.at(way.lane.s_m + ahead_m)
    edges = tuple(lane.edge_id for lane in way.lane.lanes if not lane.is_internal)
    own_way = view.way_from(pose, (*edges, *view.scene.routes[view.scene.target]))
    if own_way is not None and not own_way.present_lane.is_internal:
        yield Newcomer(own_way, min(speed_mps, own_way.lane.speed_mps), agent_class)


def _is_free(view: SituationView, newcomer: Newcomer, taken: Sequence[Newcomer]) -> bool:
    """Return whether there is room for *newcomer* beside all others and those *taken*, and near the target."""
    history, target = view.scene.history, view.scene.target
    rows = np.flatnonzero(history.valid[:, -1])
    distance = np.linalg.norm(history.xy_m[rows, -1] - newcomer.xy_m, axis=-1)
    # extrapolated, to include the junction behind
    s, left = newcomer.way.line.project(history.xy_m[rows, -1], extrapolate=True)
    room = _APART_M + _APART_S * newcomer.speed_mps
    same_lane = (np.abs(left) < _IN_LANE_M) & (np.abs(s - newcomer.way.lane.s_m) < room)
    is_clear = bool((distance > np.where(same_lane, room, _BESIDE_M)).all())
    from_target = float(distance[rows == target].min(initial=np.inf))
    is_clear = is_clear and _meets_nobody(view, newcomer)
    from_taken = [float(np.linalg.norm(newcomer.xy_m - other.xy_m)) for other in taken]
    is_in_range = _least_distance_m(view) < from_target < _FARTHEST_M
    return is_clear and is_in_range and min(from_taken, default=np.inf) > _APART_M


def _least_distance_m(view: SituationView) -> float:
    """Return the distance from the target beyond which a vehicle may be inserted now."""
    return _FROM_TARGET_M if is_first_plan(view) else _LATER_FROM_TARGET_M


def _meets_nobody(view: SituationView, newcomer: Newcomer) -> bool:
    """Return whether *newcomer* stays clear of all but the target for a while, if all keep their speeds."""
    times = CHECK_TIMES_S[CHECK_TIMES_S <= _CLEAR_FOR_S]
    rows = np.array([row for row in view.ways if row != view.scene.target], dtype=np.int64)
    own_xy = newcomer.way.poses(newcomer.speed_mps * times, times)[0]
    others_xy = view.constant_speed_poses(rows)[0][:, : len(times)]
    return bool((np.linalg.norm(others_xy - own_xy, axis=-1) > _CLEAR_M).all())
