"""Keeps sampled plans plausible by construction; applied to every plan, guided or not.

In this order: a vehicle whose plan leaves the road or goes on beside it (it stops where it has no lane), one that is
no attacker and plans to drive on the wrong side, and one that has crept on a junction for its whole history or plans
to stop on one, follows its lane instead, or stops where it is too fast for that; all are slowed to their share of the
speed limit (``speed_bound``); one that stands and has nowhere to go stands exactly still, and one that has stood for
its whole history and means to leave within its plan leaves now; who has no plan and has stood for as long is taken to
stand; who follows the target keeps a gap in which it can stop (``following_gap``); plans are braked (``braking``)
where boxes would meet, a red light would be passed, or the right of way of the target would be taken. Who could not
avoid another box by braking drives on as the plan before said, which was free, or along its lane, where that helps.
Attackers are left alone towards the target, and signals do not bind them; everybody else behaves. Around reckless
ones, who is far from the target follows its lane, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.signal_letters import RED, YELLOW
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.planning.braking import LADDER_MPS2, SIDE_M, Braked, brake, brake_ahead
from advdiff_sumo.traffic.planning.following_gap import keep_back
from advdiff_sumo.traffic.planning.futures import STANDS_MPS, WALKS_MPS, Futures, standing
from advdiff_sumo.traffic.planning.lane_following import follow
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.planning.people import PEOPLE_SIDE_M
from advdiff_sumo.traffic.planning.right_of_way import right_of_way
from advdiff_sumo.traffic.planning.road_bound import drives_against, leaves_road
from advdiff_sumo.traffic.planning.speed_bound import bound_speeds

_FAR_M = 55.0
"""Farther from the target, vehicles among reckless ones follow their lanes, as in the paper's tables here."""
_NOWHERE_M, _NOWHERE_STEPS = 0.3, 3
_LEAVES_M, _BUDGES_M = 1.5, 0.1
_CLEARS_M = 1.5
LOST_BRAKE_MPS2 = 6.0
"""How who is lost, or too fast for its lane, brakes."""
_STOP_BRAKE_MPS2, _YELLOW_BRAKE_MPS2 = 6.0, 3.0
_BEFORE_LINE_M = 1.0
_LOOK_STEPS = 6
"""Instants of a plan that have to be clear: 3 s, from 14 m/s a stop at less than 5 m/s²."""

VehiclePlan: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Positions (T, 2), headings (T,) and speeds (T,) of one vehicle."""


@dataclass(frozen=True)
class SafeguardInput:
    """What the safeguard knows of N road users.

    Attributes:
        planned: (N,) whose futures are plans; the others' are predictions and stay.
        attacker: (N,) who is guided against the target.
        target: row of the target.
        motor: (N,) who is a motor vehicle.
        people: (N,) who is on foot or on a bicycle, and is given more room.
        stood: (N,) who has not moved for as long as its history goes back; who is not planned is taken to stay so.
        dawdled: (N,) who has been no faster than walking pace for as long.
        over_limit: (N,) highest share of the speed limit that each may drive at.
        lanes: what each would follow, where asked for.
        signals: states of the traffic lights.
        waits_m: (N,) how far each may drive before the target has passed, which has the right of way over it.
        before: row → what is left of the plan before, as long as the new one.
        keeps_back: whether who follows the target keeps so far behind that it can stop if that brakes in full.
        lanes_afar: whether who is far from the target follows its lane.
    """

    planned: BoolArray
    attacker: BoolArray
    target: int
    motor: BoolArray
    people: BoolArray
    stood: BoolArray
    dawdled: BoolArray
    over_limit: FloatArray
    lanes: Sequence[LaneAhead | None]
    signals: Mapping[str, str]
    waits_m: FloatArray
    before: Mapping[int, VehiclePlan] = field(default_factory=dict)
    keeps_back: bool = False
    lanes_afar: bool = False


@dataclass(frozen=True)
class SafeguardedPlans:
    """Plans after the safeguard and what it did, each (N,).

    Attributes:
        futures: the plans.
        lane: follows its lane, as its plan would have left the road or its side of it.
        held: stands still.
        braked: was slowed down.
        unsolved: its box meets another one however hard it brakes.
    """

    futures: Futures
    lane: BoolArray
    held: BoolArray
    braked: BoolArray
    unsolved: BoolArray


def safeguard(road: RoadMap, futures: Futures, watched: SafeguardInput) -> SafeguardedPlans:
    """Return plausible plans near *futures*."""
    plans = futures.copy()
    standing(plans, watched.stood & ~watched.planned)
    nowhere = np.array([lane is None for lane in watched.lanes], dtype=np.bool_)
    off = leaves_road(road, plans, watched.planned, watched.motor)
    lost = off & nowhere
    off |= drives_against(road, plans, watched.planned & ~watched.attacker & ~nowhere)
    far = np.linalg.norm(plans.xy_m[:, 0] - plans.xy_m[watched.target, 0], axis=-1) > _FAR_M
    far &= watched.planned & ~watched.attacker & watched.lanes_afar
    followed = (off | far | _blocks_junction(plans, watched)) & ~nowhere
    back_to_lane(plans, np.flatnonzero(followed), watched)
    rows = np.flatnonzero(watched.planned)
    bound_speeds(plans, rows, watched.lanes, road.legal_limits_mps, watched.over_limit)
    fast = followed & (plans.speed_mps[:, 0] > WALKS_MPS)
    wide = leaves_road(road, plans, fast, watched.motor)  # too fast for its lane
    moved = plans.travelled_m()
    held = watched.planned & (plans.speed_mps[:, 0] < STANDS_MPS)
    held &= moved[:, min(_NOWHERE_STEPS, plans.steps)] < _NOWHERE_M
    starts = held & watched.stood & (moved[:, -1] > _LEAVES_M)
    for row in np.flatnonzero(starts).tolist():
        _start_now(plans, row)
    held &= ~starts
    standing(plans, held)
    may = watched.planned & ~held
    stop = stop_distances(plans, watched, may)
    slows = lost | wide
    stop[slows] = np.minimum(stop[slows], 0.5 * plans.speed_mps[slows, 0] ** 2 / LOST_BRAKE_MPS2)
    clear = _settled(plans, watched, may, stop, right_of_way(road, watched.lanes))
    return SafeguardedPlans(clear.futures, off & ~lost, held, clear.rows, clear.unsolved)


def _blocks_junction(futures: Futures, watched: SafeguardInput) -> BoolArray:
    """Return (N,) who has stood or crept on a junction for its whole history, or plans to stop on one.

    Of attackers, only who has, and plans to stay.
    """
    driven = futures.travelled_m()[:, min(_LOOK_STEPS, futures.steps)]
    dawdled = watched.planned & watched.dawdled & _inside(watched.lanes, np.zeros(futures.agents))
    stops = futures.speed_mps[:, min(_LOOK_STEPS, futures.steps)] < STANDS_MPS
    stops &= watched.planned & _inside(watched.lanes, driven)
    return np.asarray(np.where(watched.attacker, dawdled & (driven < _CLEARS_M), dawdled | stops))


def _inside(lanes: Sequence[LaneAhead | None], driven_m: FloatArray) -> BoolArray:
    """Return (N,) who is on a junction, or on its way out of one, after *driven_m* (N,) along its lane."""
    out = np.zeros(len(lanes), dtype=np.bool_)
    for row, lane in enumerate(lanes):
        if lane is not None:
            ends = np.cumsum([part.length_m for part in lane.lanes]) - lane.s_m
            part = min(int(np.searchsorted(ends, driven_m[row], side="right")), len(ends) - 1)
            out[row] = lane.lanes[part].is_internal or lane.s_m + driven_m[row] < 0.0
    return out


def _settled(
    futures: Futures, watched: SafeguardInput, may: BoolArray, stop_m: FloatArray, yields: BoolArray
) -> Braked:
    """Return *futures* braked; who is not clear then tries the plan before, then its lane."""
    minds = _minds(watched)
    side = np.where(watched.people, PEOPLE_SIDE_M, SIDE_M)
    behind = may & ~watched.people & watched.keeps_back
    keeps = keep_back(futures, behind, watched.target, LADDER_MPS2)
    best = _braked(futures, may, minds, stop_m, side, yields)
    for way in (_as_before, back_to_lane):
        rows = np.flatnonzero(best.unsolved)
        if not len(rows):
            break
        other = futures.copy()
        way(other, rows, watched)
        keeps |= keep_back(other, behind, watched.target, LADDER_MPS2)
        tried = _braked(other, may, minds, stop_m, side, yields)
        if tried.unsolved.sum() < best.unsolved.sum():
            futures, best = other, tried
    return replace(best, rows=best.rows | keeps)


def _braked(
    futures: Futures,
    may: BoolArray,
    minds: BoolArray,
    stop_m: FloatArray,
    side_m: FloatArray,
    yields: BoolArray,
) -> Braked:
    stopped = brake(futures, may, np.zeros_like(minds), stop_m)  # a stop line stays where it is, however far
    clear = brake_ahead(stopped.futures, may, minds, stop_m, _LOOK_STEPS, side_m, yields)
    return Braked(clear.futures, stopped.rows | clear.rows, stopped.unsolved | clear.unsolved)


def _minds(watched: SafeguardInput) -> BoolArray:
    """Return (N, N) whether the first gives way to the second: everybody to all, but attackers to the target."""
    count = len(watched.planned)
    minds = ~np.eye(count, dtype=np.bool_)
    minds[watched.attacker, watched.target] = False
    return minds


def _as_before(futures: Futures, rows: IntArray, watched: SafeguardInput) -> None:
    """Let those of *rows* (V,) that have one go on with the plan before, in place."""
    for row in rows.tolist():
        if row in watched.before:
            futures.put(row, *watched.before[row])


def back_to_lane(futures: Futures, rows: IntArray, watched: SafeguardInput) -> None:
    """Let those of *rows* (V,) that have one follow their lanes, in place."""
    own = {row: lane for row in rows.tolist() if (lane := watched.lanes[row]) is not None}
    if own:
        who = np.array(list(own))
        now = futures.xy_m[who, 0], futures.yaw_rad[who, 0], futures.speed_mps[who, 0]
        plan = follow(list(own.values()), *now, futures.size_m[who, 0], futures.steps, futures.dt_s)
        futures.xy_m[who, 1:], futures.yaw_rad[who, 1:], futures.speed_mps[who, 1:] = plan


def _start_now(futures: Futures, row: int) -> None:
    """Leave the wait at the beginning of a plan out, in place.

    A plan that starts in a second is never driven where each next one starts in a second again.
    """
    wait = int((futures.travelled_m()[row] > _BUDGES_M).argmax()) - 1
    steps = np.minimum(np.arange(1, futures.steps + 1) + max(wait, 0), futures.steps)
    futures.put(row, futures.xy_m[row, steps], futures.yaw_rad[row, steps], futures.speed_mps[row, steps])


def stop_distances(futures: Futures, watched: SafeguardInput, rows: BoolArray) -> FloatArray:
    """Return (N,) how far each of *rows* may go before a red light or giving way; no light stops attackers.

    A yellow light counts where it asks for no more than comfortable braking, and a red one where the vehicle can
    stop at all: who is over the line, or too near to stop, goes on, as in real traffic.
    """
    stop = np.where(rows, watched.waits_m, np.inf)
    for row in np.flatnonzero(rows & ~watched.attacker).tolist():
        lane = watched.lanes[row]
        for distance, link in lane.stops[:1] if lane is not None else ():
            room = distance - 0.5 * futures.size_m[row, 0] - _BEFORE_LINE_M
            need = 0.5 * futures.speed_mps[row, 0] ** 2 / max(room, 0.1)
            if need <= _limit(link.signal(watched.signals)) and room > -_BEFORE_LINE_M:
                stop[row] = min(stop[row], max(room, 0.0))
    return stop


def _limit(state: str) -> float:
    """Return the deceleration up to which a driver stops at a light of that state."""
    if state in RED:
        return _STOP_BRAKE_MPS2
    return _YELLOW_BRAKE_MPS2 if state in YELLOW else -1.0
