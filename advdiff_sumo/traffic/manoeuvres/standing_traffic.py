"""Vehicles that stand or crawl ahead of the target: a queue, one that a leader hides, or one beside the target's lane.

They are inserted beyond the target's sight and stay in the plan while out of sight: their positions follow from where
they began.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps.lanes import SIDES, Lane, lanes_beside
from advdiff_sumo.traffic.manoeuvres.ordinary_driving import ORDINARY_DRIVING_S
from advdiff_sumo.traffic.manoeuvres.repertoire import PULL_OUT, SLOW_ENTRIES, SLOW_MERGE
from advdiff_sumo.traffic.manoeuvres.required_braking import REACTION_S
from advdiff_sumo.traffic.manoeuvres.situation_view import NEAR_M, ROAD_BEYOND_M, SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S, PLAN_STEPS
from advdiff_sumo.traffic.manoeuvres.staging import (
    HIDDEN_LASTS_S,
    Newcomer,
    StagingMemory,
    has_line_within,
    with_newcomers,
)
from advdiff_sumo.traffic.manoeuvres.ways import Way, lane_at
from advdiff_sumo.traffic.planning.lanes_ahead import lane_ahead

QUEUE = "queue"
"""The kind of attack by the end of a queue."""
_MAX_CLOSING_MPS, _TARGET_BRAKING_MPS2 = 22.0, 4.0
"""Highest closing speed: a careful driver who perceives the queue at 80 m then brakes with 4 m/s²."""
_MIN_TARGET_MPS = 10.0
_OUT_OF_SIGHT_M, _LENGTHS_M = 90.0, 8.0
"""Least distance of a queue; half the lengths of both vehicles, and some more."""
_QUEUE_LASTS_S, _PAUSE_S = 20.0, 20.0
_LASTS_S: Mapping[str, float] = {QUEUE: _QUEUE_LASTS_S, "cut-out": 60.0, SLOW_MERGE: 20.0, PULL_OUT: 20.0}
"""Longest durations; a slow vehicle that a leader hides drives for ``staging.HIDDEN_LASTS_S`` alone."""
_STAGGER_M = 3.0  # offset along the road from one lane's vehicle to the next one's
_CLOSED_UP_MPS = 0.5  # a target that is no more than this faster than the queue has closed up
_FREE_M, _FREE_S, _IN_LANE_M = 8.0, 1.0, 2.0
"""Room that a crawling vehicle needs ahead: constant, per m/s; lateral."""


@dataclass(frozen=True)
class StandingTraffic:
    """Vehicles that stand, or crawl, ahead of the target.

    Attributes:
        kind: the manoeuvre they are for: ``QUEUE``, "cut-out" (a leader hides one), or one of ``SLOW_ENTRIES`` (one is
            beside the target's lane).
        members: each with its way as it was inserted, which it follows at constant speed.
        since_s: when they were inserted.
        next_try_s: when the next queue may come.
    """

    kind: str = QUEUE
    members: tuple[Newcomer, ...] = ()
    since_s: float = 0.0
    next_try_s: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """The members' ids."""
        return tuple(member.name for member in self.members)

    @property
    def hidden_names(self) -> tuple[str, ...]:
        """Ids of the vehicles that a leader hides, which attackers heed at any distance."""
        return self.names if self.kind == "cut-out" else ()

    @property
    def _lasts_s(self) -> float:
        """The longest duration of its presence."""
        return HIDDEN_LASTS_S if _is_slow_hidden(self.kind, self.members) else _LASTS_S[self.kind]

    @property
    def is_queue(self) -> bool:
        """Whether there is the end of a queue, beside which no other vehicle attacks."""
        return self.kind == QUEUE and bool(self.members)

    def is_passive(self, name: str) -> bool:
        """Return whether *name* is a member that only stands or crawls, and begins no manoeuvre."""
        return name in self.names and self.kind not in SLOW_ENTRIES

    def without(self, names: Container[str]) -> StandingTraffic:
        """Return it without those *names* that have begun the manoeuvre for which they were inserted."""
        return replace(self, members=tuple(member for member in self.members if member.name not in names))

    def updated(self, view: SituationView) -> StandingTraffic:
        """Return what is left of it: none once the target is past it or, at a queue, has closed up.

        None is left either if its first member, on the target's lane, could not be inserted.
        """
        present = tuple(member for member in self.members if member.name in view.scene.history.index)
        age_s = view.scene.time_s - self.since_s
        has_first = bool(present) and present[0] is self.members[0]
        if not has_first or age_s >= self._lasts_s or _is_over(view, present, self.kind):
            return replace(self, members=())
        return replace(self, members=present)

    def poses(self, member: Newcomer, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return centres (T, 2) and headings (T,) of a member at *time_s* (T,) of the episode."""
        since = time_s - self.since_s
        return member.way.poses(member.speed_mps * since, since)

    def motions(self, time_s: float) -> Iterator[tuple[str, tuple[FloatArray, FloatArray, FloatArray]]]:
        """Yield id, and centres (T, 2), headings (T,) and speeds (T,) of each member for a plan at *time_s*."""
        times = time_s + PLAN_DT_S * np.arange(1.0, PLAN_STEPS + 1.0)
        for member in self.members:
            yield member.name, (*self.poses(member, times), np.full(PLAN_STEPS, member.speed_mps))


def insert_queue(
    view: SituationView, stage: StagingMemory, standing: StandingTraffic
) -> tuple[StandingTraffic, StagingMemory]:
    """Return the end of a queue that is inserted now, if there is room for one, and the updated memory."""
    now = view.scene.time_s
    room = stage.most - stage.count
    if standing.members or now < standing.next_try_s or room < 1:
        return standing, stage
    members = tuple(
        replace(
            place,
            agent_class=stage.classes[(stage.count + k) % len(stage.classes)],
            name=f"staged-{stage.count + k}",
        )
        for k, place in enumerate(_queue_places(view)[:room])
    )
    if not members:
        return standing, stage
    queue = StandingTraffic(QUEUE, members, now, now + _QUEUE_LASTS_S + _PAUSE_S)
    return queue, replace(stage, count=stage.count + len(members))


def can_insert_queue(view: SituationView) -> bool:
    """Return whether there seems to be room for the end of a queue."""
    return bool(_queue_places(view))


def with_standing(plan: JointPlan, standing: StandingTraffic, time_s: float) -> JointPlan:
    """Return *plan*, made at *time_s*, with those members of *standing* that it does not move already."""
    tracks = plan.tracks
    members = [member for member in standing.members if member.name not in tracks.index]
    steps = tracks.steps if tracks.agents else PLAN_STEPS
    times = time_s + PLAN_DT_S * np.arange(1.0, steps + 1.0)
    return with_newcomers(plan, members, [standing.poses(member, times) for member in members])


def _queue_places(view: SituationView) -> list[Newcomer]:
    """Return a standing or crawling vehicle for each lane ahead, the target's first; none if there is no room."""
    target = view.target
    if target is None or target.speed_mps < _MIN_TARGET_MPS or not view.is_clear_to(NEAR_M):
        return []
    crawl_mps = max(target.speed_mps - _MAX_CLOSING_MPS, 0.0)
    ahead_m, crawled_m = _queue_distance_m(target.speed_mps - crawl_mps), crawl_mps * _QUEUE_LASTS_S
    way = view.extended_way(target.way, ahead_m + crawled_m)
    must_wait = has_line_within(way, ahead_m + ROAD_BEYOND_M)
    target_lane, s = lane_at(way, way.lane.s_m + ahead_m)
    if must_wait or way.lane.end_m < ahead_m + crawled_m or target_lane.is_internal:
        return []
    edges = tuple(lane.edge_id for lane in way.lane.lanes if not lane.is_internal)
    places = []
    for k, lane in enumerate(_lanes_abreast(view, target_lane)):
        start_s = min(s + k * _STAGGER_M, lane.length_m)
        ahead = lane_ahead(view.road.lanes, lane, start_s, 0.0, edges, crawled_m)
        if k == 0 or ahead.end_m > crawled_m:
            places.append(Newcomer(Way(ahead), min(crawl_mps, lane.speed_mps)))
    return places


def _queue_distance_m(closing_mps: float) -> float:
    """Return how far ahead a queue ends, so that a careful driver brakes with 4 m/s² after 3 s without a demand."""
    braking_m = 0.5 * closing_mps**2 / _TARGET_BRAKING_MPS2
    distance_m = closing_mps * (ORDINARY_DRIVING_S + REACTION_S) + braking_m + _LENGTHS_M
    return max(distance_m, _OUT_OF_SIGHT_M)


def _lanes_abreast(view: SituationView, lane: Lane) -> Iterator[Lane]:
    """Yield *lane* and the lanes beside it in the same direction."""
    yield lane
    for side in SIDES:
        yield from takewhile(lambda beside: beside.is_drivable, lanes_beside(view.road.lanes, lane.id, side))


def _is_over(view: SituationView, members: tuple[Newcomer, ...], kind: str) -> bool:
    """Return whether the target is past *members*, has closed up to a queue, or a slow one has a leader.

    The target may also close up to a slow vehicle that a leader hid.
    """
    history, target = view.scene.history, view.scene.target
    rows = [history.index[member.name] for member in members]
    offset = history.xy_m[rows, -1] - history.xy_m[target, -1]
    ahead = offset @ unit(history.yaw_rad[target, -1])
    is_closed_up_to = kind == QUEUE or _is_slow_hidden(kind, members)
    closed_up = is_closed_up_to and view.speed(target) <= members[0].speed_mps + _CLOSED_UP_MPS
    if (ahead < 0.0).all() or closed_up:
        return True
    crawling = (row for row, member in zip(rows, members, strict=True) if member.speed_mps)
    return any(_has_leader(history, row, rows) for row in crawling)


def _is_slow_hidden(kind: str, members: tuple[Newcomer, ...]) -> bool:
    """Return whether *members*, at least one, are a vehicle that a leader hides and that drives."""
    return kind == "cut-out" and members[0].speed_mps > 0.0


def _has_leader(history: Tracks, row: int, members: list[int]) -> bool:
    """Return whether a vehicle that is no member is so close ahead of *row* that it cannot keep its speed."""
    others = np.setdiff1d(np.flatnonzero(history.valid[:, -1]), members)
    heading = unit(history.yaw_rad[row, -1])
    offset = history.xy_m[others, -1] - history.xy_m[row, -1]
    ahead, left = offset @ heading, offset @ np.array([-heading[1], heading[0]])
    reach = _FREE_M + _FREE_S * float(history.speed_mps[row, -1])
    return bool(((ahead > 0.0) & (ahead < reach) & (np.abs(left) < _IN_LANE_M)).any())
