"""Vehicles that stand ahead of the target: a queue on every lane, which may crawl, whom a leader hides, who is beside.

They come in beyond the target's sight, and stay in the plan out of sight: where they are follows from where they began.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.manoeuvres.answers import REACTION_S
from advdiff_sumo.traffic.manoeuvres.ordinary_driving import ORDINARY_DRIVING_S
from advdiff_sumo.traffic.manoeuvres.repertoire import PULL_OUT, SLOW_ENTRIES, SLOW_MERGE
from advdiff_sumo.traffic.manoeuvres.situation_view import NEAR_M, ROAD_BEYOND_M, SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S, PLAN_STEPS
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, StagingMemory, with_newcomers
from advdiff_sumo.traffic.manoeuvres.ways import Way
from advdiff_sumo.traffic.planning.lanes_ahead import lane_ahead

QUEUE = "queue"
"""The kind of attack of who is the end of a queue."""
_FASTEST_CLOSING_MPS, _STOPS_MPS2 = 22.0, 4.0
"""How fast the target comes up to them at most: a careful driver who sees them at 80 m then brakes with 4 m/s²."""
_LEAST_SPEED_MPS = 10.0
_OUT_OF_SIGHT_M, _LENGTHS_M = 90.0, 8.0
_LASTS_S, _PAUSE_S = 20.0, 20.0
_LAST_S: Mapping[str, float] = {QUEUE: _LASTS_S, "cut-out": 60.0, SLOW_MERGE: 20.0, PULL_OUT: 20.0}
_STAGGER_M = 3.0
_CLOSED_UP_MPS = 0.5
_FREE_M, _FREE_S, _IN_LANE_M = 8.0, 1.0, 2.0


@dataclass(frozen=True)
class StandingTraffic:
    """Who stands, or crawls, ahead of the target.

    Attributes:
        kind: what they are for: ``QUEUE``, "cut-out" for somebody whom a leader hides, or one of ``SLOW_ENTRIES`` for
            somebody beside the target's lane.
        members: each on its way as it came in, on which it goes on at its speed.
        since_s: when they came in.
        again_s: when the next queue may come.
    """

    kind: str = QUEUE
    members: tuple[Newcomer, ...] = ()
    since_s: float = 0.0
    next_try_s: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """The members' ids."""
        return tuple(one.name for one in self.members)

    @property
    def is_queue(self) -> bool:
        """Whether there is the end of a queue, beside which nobody else attacks."""
        return self.kind == QUEUE and bool(self.members)

    def is_passive(self, name: str) -> bool:
        """Return whether *name* is a member that only stands or goes on, and begins nothing of its own."""
        return name in self.names and self.kind not in SLOW_ENTRIES

    def without(self, names: Container[str]) -> StandingTraffic:
        """Return it without those *names* who have begun what they came in for."""
        return replace(self, members=tuple(one for one in self.members if one.name not in names))

    def updated(self, view: SituationView) -> StandingTraffic:
        """Return what is left of it: it moves off once the target is past it or, at a queue, has closed up.

        Without its first member, on the target's lane, for whom there was no room, it is none.
        """
        there = tuple(one for one in self.members if one.name in view.scene.history.index)
        lasts_s = view.scene.time_s - self.since_s
        begun = bool(there) and there[0] is self.members[0]
        if not begun or lasts_s >= _LAST_S[self.kind] or _is_over(view, there, self.kind):
            return replace(self, members=())
        return replace(self, members=there)

    def poses(self, one: Newcomer, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return centres (T, 2) and headings (T,) of a member at *time_s* (T,) of the episode."""
        since = time_s - self.since_s
        return one.way.poses(one.speed_mps * since, since)

    def motions(self, time_s: float) -> Iterator[tuple[str, tuple[FloatArray, FloatArray, FloatArray]]]:
        """Yield id, and centres (T, 2), headings (T,) and speeds (T,) of each member for a plan at *time_s*."""
        times = time_s + PLAN_DT_S * np.arange(1.0, PLAN_STEPS + 1.0)
        for one in self.members:
            yield one.name, (*self.poses(one, times), np.full(PLAN_STEPS, one.speed_mps))


def insert_queue(
    view: SituationView, stage: StagingMemory, standing: StandingTraffic
) -> tuple[StandingTraffic, StagingMemory]:
    """Return the end of a queue that comes in now, if there is room for one, and what staging remembers."""
    now = view.scene.time_s
    room = stage.most - stage.count
    if standing.members or now < standing.next_try_s or room < 1:
        return standing, stage
    members = tuple(
        replace(
            one,
            agent_class=stage.classes[(stage.count + k) % len(stage.classes)],
            name=f"staged-{stage.count + k}",
        )
        for k, one in enumerate(_places(view)[:room])
    )
    if not members:
        return standing, stage
    queue = StandingTraffic(QUEUE, members, now, now + _LASTS_S + _PAUSE_S)
    return queue, replace(stage, count=stage.count + len(members))


def can_insert_queue(view: SituationView) -> bool:
    """Return whether there is room for the end of a queue, as far as is seen."""
    return bool(_places(view))


def with_standing(plan: JointPlan, standing: StandingTraffic, time_s: float) -> JointPlan:
    """Return *plan*, made at *time_s*, with those members of *standing* whom it does not move already."""
    tracks = plan.tracks
    members = [one for one in standing.members if one.name not in tracks.index]
    steps = tracks.steps if tracks.agents else PLAN_STEPS
    times = time_s + PLAN_DT_S * np.arange(1.0, steps + 1.0)
    return with_newcomers(plan, members, [standing.poses(one, times) for one in members])


def _places(view: SituationView) -> list[Newcomer]:
    """Return who stands, or crawls, on each lane ahead, on the target's first; nobody where there is no room."""
    target = view.target
    if target is None or target.speed_mps < _LEAST_SPEED_MPS or not view.is_clear_to(NEAR_M):
        return []
    crawls = max(target.speed_mps - _FASTEST_CLOSING_MPS, 0.0)
    ahead, drives = _ahead_m(target.speed_mps - crawls), crawls * _LASTS_S
    way = view.extended_way(target.way, ahead + drives)
    waits = any(
        reach < ahead + ROAD_BEYOND_M and (link.yields or link.tls_id is not None)
        for reach, link in way.links
    )
    there, s = lane_at(way, way.lane.s_m + ahead)
    if waits or way.lane.end_m < ahead + drives or there.is_internal:
        return []
    edges = tuple(one.edge_id for one in way.lane.lanes if not one.is_internal)
    out = []
    for k, lane in enumerate(_abreast(view, there)):
        on = lane_ahead(view.road.lanes, lane, min(s + k * _STAGGER_M, lane.length_m), 0.0, edges, drives)
        if k == 0 or on.end_m > drives:
            out.append(Newcomer(Way(on), min(crawls, lane.speed_mps)))
    return out


def _ahead_m(closing_mps: float) -> float:
    """Return how far ahead a queue ends: for 3 s it asks nothing, and a careful driver then brakes with 4 m/s²."""
    ahead = closing_mps * (ORDINARY_DRIVING_S + REACTION_S) + 0.5 * closing_mps**2 / _STOPS_MPS2 + _LENGTHS_M
    return max(ahead, _OUT_OF_SIGHT_M)


def lane_at(way: Way, s_m: float) -> tuple[Lane, float]:
    """Return the lane of *way* that is *s_m* from where its first lane begins, and the place on it."""
    for lane in way.lane.lanes:
        if s_m <= lane.length_m:
            return lane, s_m
        s_m -= lane.length_m
    last = way.lane.lanes[-1]
    return last, last.length_m


def _abreast(view: SituationView, lane: Lane) -> Iterator[Lane]:
    """Yield *lane* and those beside it that are driven the same way."""
    yield lane
    lanes = view.road.lanes
    for to_left in (True, False):
        beside = lane.left_id if to_left else lane.right_id
        while beside is not None and lanes[beside].is_drivable:
            yield lanes[beside]
            beside = lanes[beside].left_id if to_left else lanes[beside].right_id


def _is_over(view: SituationView, members: tuple[Newcomer, ...], kind: str) -> bool:
    """Return whether the target is past *members* or has closed up to a queue, or one that moves has a leader."""
    now, target = view.scene.history, view.scene.target
    rows = [now.index[one.name] for one in members]
    offset = now.xy_m[rows, -1] - now.xy_m[target, -1]
    ahead = offset @ unit(now.yaw_rad[target, -1])
    closed_up = kind == QUEUE and view.speed(target) <= members[0].speed_mps + _CLOSED_UP_MPS
    if (ahead < 0.0).all() or closed_up:
        return True
    return any(_has_leader(now, row, rows) for row, one in zip(rows, members, strict=True) if one.speed_mps)


def _has_leader(now: Tracks, row: int, members: list[int]) -> bool:
    """Return whether somebody else is so close ahead of *row* that it could not go on at its speed."""
    others = np.setdiff1d(np.flatnonzero(now.valid[:, -1]), members)
    facing = unit(now.yaw_rad[row, -1])
    offset = now.xy_m[others, -1] - now.xy_m[row, -1]
    ahead, left = offset @ facing, offset @ np.array([-facing[1], facing[0]])
    reach = _FREE_M + _FREE_S * float(now.speed_mps[row, -1])
    return bool(((ahead > 0.0) & (ahead < reach) & (np.abs(left) < _IN_LANE_M)).any())
