"""Staging: vehicles that come in where an encounter lacks them, as traffic that arrives from further away.

At the first plan of an episode, before anybody has seen anybody, they may stand nearer than later on.
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
from advdiff_sumo.traffic.manoeuvres.company import company_places, insertion_places
from advdiff_sumo.traffic.manoeuvres.priority_traffic import SLOWEST_TARGET_MPS, Approach, priority_approaches
from advdiff_sumo.traffic.manoeuvres.repertoire import DOUBLE, HEADWAY_S, STOPS_FROM_MPS
from advdiff_sumo.traffic.manoeuvres.situation_view import ROAD_BEYOND_M, SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, PLAN_DT_S, PLAN_STEPS
from advdiff_sumo.traffic.manoeuvres.ways import Way

SIZE_M = {AgentClass.CAR: (4.6, 1.8), AgentClass.TRUCK: (9.0, 2.4), AgentClass.MOTORCYCLE: (2.2, 0.8)}
"""Length and width of who comes in."""
BUS_SIZE_M = (12.0, 2.5)
"""The same of a bus, which only comes in at a kerb."""
STAGED = 6
"""Most vehicles that come in during an episode, if nobody says otherwise."""
_AGAIN_S = 2.0
_NO_PLACE_BEFORE = RED | {PLAIN_YELLOW}
"""Signals shortly before which nobody comes in."""
NO_LEADER_WITHIN_M = 55.0
"""Within which nobody may lead the target where somebody is to come in."""
_LATER_M, _FARTHEST_M = 36.0, 72.0
_LEAST_AHEAD_M, _SPARE_M, _NEARLY_M = 22.0, 3.0, 10.0
_LEADS_MORE_M = (0.0, 5.0, 10.0, 15.0)
_APART_M, _APART_S = 9.0, 0.6
_FROM_TARGET_M, _LATER_FROM_TARGET_M = 18.0, 30.0
_IN_LANE_M, _BESIDE_M = 2.0, 6.0
_MEETS_S, _CLEAR_M = 4.0, 3.0
_LEAST_HIDES_M, _FASTEST_HIDING_MPS = 18.5, 17.0
_HIDDEN_S = 5.0


@dataclass(frozen=True)
class StagingMemory:
    """What staging remembers.

    Attributes:
        most: vehicles that may come in during an episode.
        classes: what comes in first, second, …; in turn.
        oncoming: whether somebody with priority comes from ahead rather than from the side.
        early_s: how long before the target it is where they meet; None: with it.
        spare_gap_m: what somebody beside leaves beyond the lawful gap.
        only_oncoming: whether nobody with priority comes from the side.
        count: of those that have come in.
        again_s: when it looks again.
    """

    most: int = 0
    classes: tuple[AgentClass, ...] = (AgentClass.CAR,)
    oncoming: bool = False
    early_s: float | None = None
    spare_gap_m: float = 0.0
    only_oncoming: bool = False
    count: int = 0
    next_try_s: float = 0.0

    @property
    def agent_class(self) -> AgentClass:
        """What comes in next."""
        return self.classes[self.count % len(self.classes)]


@dataclass(frozen=True)
class Newcomer(Approach):
    """Somebody who comes in; its way begins where it is now.

    Attributes:
        agent_class: what it is.
        name: its id, once it is sure to come in.
        onward: edges that it is to drive; (): those of its way.
    """

    agent_class: AgentClass = AgentClass.CAR
    name: str = ""
    onward: tuple[str, ...] = ()

    @staticmethod
    def size_of(agent_class: AgentClass) -> tuple[float, float]:
        """Return length and width of who comes in as *agent_class*."""
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
    """Return who comes in now, for manoeuvres of *kinds*, and what is remembered."""
    now = view.scene.time_s
    if view.target is None or stage.count >= stage.most or now < stage.next_try_s:
        return (), stage
    taken: list[Newcomer] = []
    roles = {
        "hard-stop": _leader(view, stage),
        "cut-in": _beside(view, stage),
        "crossing": _with_priority(view, stage),
    }
    for candidates in (newcomers for kind, newcomers in roles.items() if kind in kinds):
        room = min(1, stage.most - stage.count - len(taken))
        taken += islice((one for one in candidates if _is_free(view, one, taken)), room)
    if DOUBLE in kinds:
        taken += _in_company(view, stage)
    if "cut-out" in kinds and not taken and stage.most - stage.count >= 2:
        taken += _hidden(view, stage)
    named = tuple(replace(one, name=f"staged-{stage.count + k}") for k, one in enumerate(taken))
    waits_s = _AGAIN_S if taken else 0.0  # the time at which somebody would meet the target is short
    return named, replace(stage, count=stage.count + len(taken), next_try_s=now + waits_s)


def plan_with(tracks: Tracks, newcomers: Sequence[Newcomer], attack: AttackState | None = None) -> JointPlan:
    """Return the plan of *tracks* and of *newcomers*, who go on along their ways.

    Args:
        tracks: at ``PLAN_DT_S``, or empty.
        newcomers: who comes in.
        attack: who can attack.
    """
    driven = PLAN_DT_S * np.arange(1.0, PLAN_STEPS + 1.0)
    poses = [one.way.poses(one.speed_mps * driven, driven) for one in newcomers]
    return with_newcomers(JointPlan(tracks, attack=attack), newcomers, poses)


def with_newcomers(
    plan: JointPlan, newcomers: Sequence[Newcomer], poses: Sequence[tuple[FloatArray, FloatArray]]
) -> JointPlan:
    """Return *plan* with *newcomers* at centres (T, 2) and headings (T,) each, as long as its tracks, if it has any."""
    if not newcomers:
        return plan
    tracks = plan.tracks
    yaw = np.stack([angles for _, angles in poses])
    more = Tracks(
        ids=tuple(one.name for one in newcomers),
        classes=np.array([int(one.agent_class) for one in newcomers]),
        size_m=np.array([Newcomer.size_of(one.agent_class) for one in newcomers]),
        xy_m=np.stack([xy for xy, _ in poses]),
        yaw_rad=yaw,
        speed_mps=np.repeat([[one.speed_mps] for one in newcomers], yaw.shape[1], axis=1),
        valid=np.ones(yaw.shape, dtype=np.bool_),
        t0_s=tracks.t0_s,
        dt_s=PLAN_DT_S,
    )
    routes = {**plan.routes, **{one.name: one.route for one in newcomers}}
    return replace(plan, tracks=tracks.joined(more) if tracks.agents else more, routes=routes)


def is_first_plan(view: SituationView) -> bool:
    """Return whether this is the first plan of an episode."""
    return view.scene.time_s < PLAN_DT_S


def _leader(view: SituationView, stage: StagingMemory, more_m: float = 0.0) -> Iterator[Newcomer]:
    """Somebody ahead in the target's lane, where nobody is, *more_m* farther than a leader keeps."""
    target = view.target
    if (
        target is None
        or target.speed_mps < SLOWEST_TARGET_MPS
        or view.is_occupied(target.way, NO_LEADER_WITHIN_M, _IN_LANE_M)
    ):
        return
    least = _LEAST_AHEAD_M if is_first_plan(view) else _LATER_M
    gap = max(HEADWAY_S * target.speed_mps + 8.0, least) + more_m
    yield from _on_way(view, target.way, gap, target.speed_mps, stage.agent_class)


def _beside(view: SituationView, stage: StagingMemory) -> Iterator[Newcomer]:
    """Somebody on the next lane, ahead of the target by what a lane change has to leave."""
    target = view.target
    if target is None or target.speed_mps < SLOWEST_TARGET_MPS or not view.is_clear_to(NO_LEADER_WITHIN_M):
        return
    speed = target.speed_mps + view.speed_gain_mps2(view.scene.target)
    least = _LEAST_AHEAD_M if is_first_plan(view) else _LATER_FROM_TARGET_M + 1.0
    for side in ("left", "right"):
        way = view.neighbour_way(view.scene.target, side)
        if way is None:
            continue
        drives = min(target.speed_mps, way.lane.speed_mps)
        gap = LAWFUL.gap_share * safe_gap_m(speed + 0.5, drives) + LAWFUL.spare_m + stage.spare_gap_m
        ahead = max(gap + SIZE_M[stage.agent_class][0] + _SPARE_M, least)
        if not view.is_occupied(
            way, NO_LEADER_WITHIN_M, _IN_LANE_M, ahead - _NEARLY_M
        ):  # who could get there itself
            yield from _on_way(view, way, ahead, drives, stage.agent_class)


def _with_priority(view: SituationView, stage: StagingMemory) -> Iterator[Newcomer]:
    """Somebody whom the target has to let pass at its next junction, there when the target is."""
    for one in priority_approaches(view, stage.oncoming, stage.early_s, stage.only_oncoming):
        yield Newcomer(one.way, one.speed_mps, stage.agent_class)


def _in_company(view: SituationView, stage: StagingMemory) -> list[Newcomer]:
    """Return a leader, and who drives beside the target and behind it, where they are lacking."""
    out: list[Newcomer] = []
    most = stage.most - stage.count - 1
    for one in _company(view):
        if len(out) < most and _is_free(view, one, ()) and _is_clear_of(one, out):
            out.append(one)
    leaders = (
        (one for more in _LEADS_MORE_M for one in _leader(view, stage, more)) if company_places(view) else ()
    )
    first = (one for one in leaders if _is_free(view, one, ()) and _is_clear_of(one, out))
    return [*islice(first, 1), *out] if most >= 0 else []


def _is_clear_of(one: Newcomer, taken: Sequence[Newcomer]) -> bool:
    """Return whether *one* comes in beside *taken* with room between."""
    return all(float(np.linalg.norm(one.xy_m - other.xy_m)) > _BESIDE_M for other in taken)


def _company(view: SituationView) -> Iterator[Newcomer]:
    """Cars on the lanes beside the target, and behind it, where nobody is yet."""
    target, row = view.target, view.scene.target
    if target is None or target.speed_mps < STOPS_FROM_MPS:
        return
    least = (_FROM_TARGET_M if is_first_plan(view) else _LATER_FROM_TARGET_M) + 1.0
    for side, at in insertion_places(view, least):
        way = view.neighbour_way(row, side) if side else target.way
        if way is not None and way.lane.s_m + at > 0.0:
            yield from _on_way(view, way, at, min(target.speed_mps, way.lane.speed_mps), AgentClass.CAR)


def can_insert_cut_out(view: SituationView) -> bool:
    """Return whether somebody who stands, and a leader before, could come in now."""
    return bool(_hidden(view, StagingMemory()))


def _hidden(view: SituationView, stage: StagingMemory) -> Sequence[Newcomer]:
    """Somebody who stands ahead of the target and a leader between, where there is a lane to go aside to."""
    target = view.target
    if target is None or not is_first_plan(view) or view.is_occupied(target.way, _FARTHEST_M, _IN_LANE_M):
        return ()
    aside = [view.neighbour_way(view.scene.target, side) for side in ("left", "right")]
    if not any(way is not None and not view.is_occupied(way, _FARTHEST_M, _IN_LANE_M) for way in aside):
        return ()
    speed = target.speed_mps
    if not SLOWEST_TARGET_MPS <= speed <= _FASTEST_HIDING_MPS:
        return ()
    leads_m = max(HEADWAY_S * speed + SIZE_M[AgentClass.CAR][0], _LEAST_HIDES_M)
    stands_m = leads_m + _HIDDEN_S * speed + SIZE_M[AgentClass.TRUCK][0]
    leader = [
        one for one in _on_way(view, target.way, leads_m, speed, AgentClass.CAR) if _is_free(view, one, ())
    ]
    standing = list(_on_way(view, view.extended_way(target.way, stands_m), stands_m, 0.0, stage.agent_class))
    return [*leader, *standing] if leader and standing and _meets_nobody(view, standing[0]) else ()


def _on_way(
    view: SituationView, way: Way, ahead_m: float, speed_mps: float, agent_class: AgentClass
) -> Iterator[Newcomer]:
    """Somebody *ahead_m* further along *way*, on no junction, before no red light and not at the road's end."""
    if ahead_m + ROAD_BEYOND_M > way.lane.end_m:
        return
    if any(reach < ahead_m + 10.0 and view.signal(link) in _NO_PLACE_BEFORE for reach, link in way.links):
        return
    pose = way.line.at(way.lane.s_m + ahead_m)
    edges = tuple(lane.edge_id for lane in way.lane.lanes if not lane.is_internal)
    there = view.way_from(pose, (*edges, *view.scene.routes[view.scene.target]))
    if there is not None and not there.present_lane.is_internal:
        yield Newcomer(there, min(speed_mps, there.lane.speed_mps), agent_class)


def _is_free(view: SituationView, one: Newcomer, taken: Sequence[Newcomer]) -> bool:
    """Return whether there is room around *one*."""
    now, target = view.scene.history, view.scene.target
    there = np.flatnonzero(now.valid[:, -1])
    apart = np.linalg.norm(now.xy_m[there, -1] - one.xy_m, axis=-1)
    s, left = one.way.line.project(now.xy_m[there, -1], extrapolate=True)  # the junction behind, too
    room = _APART_M + _APART_S * one.speed_mps
    same_lane = (np.abs(left) < _IN_LANE_M) & (np.abs(s - one.way.lane.s_m) < room)
    clear = bool((apart > np.where(same_lane, room, _BESIDE_M)).all())
    from_target = float(apart[there == target].min(initial=np.inf))
    clear = clear and _meets_nobody(view, one)
    others = [float(np.linalg.norm(one.xy_m - other.xy_m)) for other in taken]
    nearest = _FROM_TARGET_M if is_first_plan(view) else _LATER_FROM_TARGET_M
    return clear and nearest < from_target < _FARTHEST_M and min(others, default=np.inf) > _APART_M


def _meets_nobody(view: SituationView, one: Newcomer) -> bool:
    """Return whether *one* stays clear of all but the target for a while, if everybody keeps its speed."""
    soon = CHECK_TIMES_S[CHECK_TIMES_S <= _MEETS_S]
    rows = np.array([row for row in view.ways if row != view.scene.target], dtype=np.int64)
    own = one.way.poses(one.speed_mps * soon, soon)[0]
    theirs = view.constant_speed_poses(rows)[0][:, : len(soon)]
    return bool((np.linalg.norm(theirs - own, axis=-1) > _CLEAR_M).all())
