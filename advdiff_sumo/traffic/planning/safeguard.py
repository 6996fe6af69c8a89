"""Makes every plan plausible before it is driven, whether it was guided or not.

In order of execution:

1. A vehicle without a plan that has stood for its whole history is predicted to stand.
2. A vehicle follows its lane if its plan leaves the road, continues beside it, or stops on a junction, and if it has
   crept on a junction for its whole history. So does one that is no attacker and plans to drive on the wrong side.
   Among reckless attackers, vehicles far from the target follow their lanes, too.
3. All vehicles are slowed to their share of the speed limit (``speed_bound``).
4. A standing vehicle that plans hardly any motion stands exactly still. One that has stood for its whole history and
   plans to depart later departs now.
5. A follower of the target keeps a gap in which it can stop (``keep_back``).
6. Plans are braked (``braking``) before collisions, red lights, and the target's right of way. A vehicle that left
   the road without a lane to follow, or is too fast to follow it, brakes to a stop.
7. If braking cannot prevent a collision, a vehicle continues its previous plan, or else follows its lane, if fewer
   vehicles collide then.

Exempt attackers need not brake for the target, and signals do not bind them.
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
from advdiff_sumo.traffic.planning.futures import STANDS_MPS, WALKS_MPS, Futures, stand_still
from advdiff_sumo.traffic.planning.keep_back import keep_back
from advdiff_sumo.traffic.planning.lane_following import follow
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.planning.people import PEOPLE_SIDE_M
from advdiff_sumo.traffic.planning.right_of_way import right_of_way
from advdiff_sumo.traffic.planning.road_bound import drives_against, leaves_road
from advdiff_sumo.traffic.planning.speed_bound import bound_speeds

_FAR_M = 55.0
"""Among reckless attackers, vehicles farther than this from the target follow their lanes."""
_STAYS_M, _STAYS_STEPS = 0.3, 3
"""A standing vehicle that plans to move less than this within so many steps is held."""
_DEPARTS_M = 1.5
"""A held vehicle whose whole plan is longer than this departs, if it has stood for its whole history."""
_MOVES_M = 0.1
"""The wait at the beginning of a plan ends where it has moved farther than this."""
_CLEARS_JUNCTION_M = 1.5
"""An attacker that has crept on a junction need not follow its lane if it plans to drive farther than this."""
LOST_BRAKE_MPS2 = 6.0
"""Deceleration of a vehicle that has no lane to follow, or is too fast for it."""
_RED_BRAKE_MPS2, _YELLOW_BRAKE_MPS2 = 6.0, 3.0
"""Vehicles stop at a red or yellow light if no harder braking is required."""
_BEFORE_LINE_M = 1.0
_LOOK_STEPS = 6
"""Instants of a plan that must be free of conflicts: 3 s, in which 5 m/s² stop a vehicle from 14 m/s."""

VehiclePlan: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Positions (T, 2), headings (T,) and speeds (T,) of one vehicle."""


@dataclass(frozen=True)
class SafeguardInput:
    """What the safeguard needs to know about N road users, besides their futures.

    Attributes:
        is_planned: (N,) whether the future is a plan that may be changed, not a prediction.
        is_attacker: (N,) whether it is guided against the target and exempt from rules.
        target: row of the target.
        is_motor: (N,) whether it is a motor vehicle.
        is_unprotected: (N,) whether it is a pedestrian or on a bicycle, which others give more room.
        has_stood: (N,) whether it has stood for its whole history; without a plan it is predicted to stand.
        has_crept: (N,) whether it has been no faster than walking pace for its whole history.
        limit_share: (N,) highest share of the speed limit.
        lanes: lanes to follow, for each; None without one, or where it is not needed.
        signals: states of the traffic lights.
        yield_stop_m: (N,) how far it may drive before the target, which has the right of way, has passed.
        previous: row → the rest of the previous plan, as long as the new one.
        keep_gap: whether followers of the target keep a gap in which they can stop if it brakes in full.
        far_follow_lanes: whether vehicles far from the target follow their lanes.
    """

    is_planned: BoolArray
    is_attacker: BoolArray
    target: int
    is_motor: BoolArray
    is_unprotected: BoolArray
    has_stood: BoolArray
    has_crept: BoolArray
    limit_share: FloatArray
    lanes: Sequence[LaneAhead | None]
    signals: Mapping[str, str]
    yield_stop_m: FloatArray
    previous: Mapping[int, VehiclePlan] = field(default_factory=dict)
    keep_gap: bool = False
    far_follow_lanes: bool = False


@dataclass(frozen=True)
class SafeguardedPlans:
    """Plans after the safeguard, and (N,) what it did to each.

    Attributes:
        futures: the plans.
        follows_lane: follows its lane because its plan would have left the road or its side of it.
        held: stands still.
        braked: was slowed down.
        unsolved: still collides, however hard it brakes.
    """

    futures: Futures
    follows_lane: BoolArray
    held: BoolArray
    braked: BoolArray
    unsolved: BoolArray


def safeguard(road: RoadMap, futures: Futures, inputs: SafeguardInput) -> SafeguardedPlans:
    """Return plausible plans near *futures*."""
    plans = futures.copy()
    stand_still(plans, inputs.has_stood & ~inputs.is_planned)
    no_lane = np.array([lane is None for lane in inputs.lanes], dtype=np.bool_)
    off_course = leaves_road(road, plans, inputs.is_planned, inputs.is_motor)
    lost = off_course & no_lane
    off_course |= drives_against(road, plans, inputs.is_planned & ~inputs.is_attacker & ~no_lane)
    far = np.linalg.norm(plans.xy_m[:, 0] - plans.xy_m[inputs.target, 0], axis=-1) > _FAR_M
    far &= inputs.is_planned & ~inputs.is_attacker & inputs.far_follow_lanes
    to_lane = (off_course | far | _blocks_junction(plans, inputs)) & ~no_lane
    back_to_lane(plans, np.flatnonzero(to_lane), inputs)
    planned_rows = np.flatnonzero(inputs.is_planned)
    bound_speeds(plans, planned_rows, inputs.lanes, road.legal_limits_mps, inputs.limit_share)
    fast = to_lane & (plans.speed_mps[:, 0] > WALKS_MPS)
    too_fast = leaves_road(road, plans, fast, inputs.is_motor)  # cannot follow its lane at its speed
    travelled = plans.travelled_m()
    held = inputs.is_planned & (plans.speed_mps[:, 0] < STANDS_MPS)
    held &= travelled[:, min(_STAYS_STEPS, plans.steps)] < _STAYS_M
    departs = held & inputs.has_stood & (travelled[:, -1] > _DEPARTS_M)
    for row in np.flatnonzero(departs).tolist():
        _depart_now(plans, row)
    held &= ~departs
    stand_still(plans, held)
    adjustable = inputs.is_planned & ~held
    stop = stop_distances(plans, inputs, adjustable)
    brakes = lost | too_fast
    stop[brakes] = np.minimum(stop[brakes], 0.5 * plans.speed_mps[brakes, 0] ** 2 / LOST_BRAKE_MPS2)
    safe = _avoid_collisions(plans, inputs, adjustable, stop, right_of_way(road, inputs.lanes))
    return SafeguardedPlans(safe.futures, off_course & ~lost, held, safe.braked, safe.unsolved)


def _blocks_junction(futures: Futures, inputs: SafeguardInput) -> BoolArray:
    """Return (N,) which vehicles have crept on a junction for their whole history, or plan to stop on one.

    An attacker counts only if it has crept there and plans to stay.
    """
    driven = futures.travelled_m()[:, min(_LOOK_STEPS, futures.steps)]
    creeps = inputs.is_planned & inputs.has_crept & _on_junction(inputs.lanes, np.zeros(futures.agents))
    stops = futures.speed_mps[:, min(_LOOK_STEPS, futures.steps)] < STANDS_MPS
    stops &= inputs.is_planned & _on_junction(inputs.lanes, driven)
    return np.asarray(np.where(inputs.is_attacker, creeps & (driven < _CLEARS_JUNCTION_M), creeps | stops))


def _on_junction(lanes: Sequence[LaneAhead | None], driven_m: FloatArray) -> BoolArray:
    """Return (N,) which vehicles are on a junction, or before their lane's beginning, *driven_m* (N,) from now."""
    on_junction = np.zeros(len(lanes), dtype=np.bool_)
    for row, lane in enumerate(lanes):
        if lane is not None:
            ends = np.cumsum([part.length_m for part in lane.lanes]) - lane.s_m
            part = min(int(np.searchsorted(ends, driven_m[row], side="right")), len(ends) - 1)
            on_junction[row] = lane.lanes[part].is_internal or lane.s_m + driven_m[row] < 0.0
    return on_junction


def _avoid_collisions(
    futures: Futures, inputs: SafeguardInput, adjustable: BoolArray, stop_m: FloatArray, must_yield: BoolArray
) -> Braked:
    """Return *futures* braked; vehicles that still collide then try their previous plan, then their lane."""
    count = len(inputs.is_planned)
    may_brake_for = ~np.eye(count, dtype=np.bool_)
    may_brake_for[inputs.is_attacker, inputs.target] = False
    side = np.where(inputs.is_unprotected, PEOPLE_SIDE_M, SIDE_M)
    followers = adjustable & ~inputs.is_unprotected & inputs.keep_gap
    kept_gap = keep_back(futures, followers, inputs.target, LADDER_MPS2)
    best = _brake(futures, adjustable, may_brake_for, stop_m, side, must_yield)
    for replace_plans in (_continue_previous, back_to_lane):
        rows = np.flatnonzero(best.unsolved)
        if not len(rows):
            break
        alternative = futures.copy()
        replace_plans(alternative, rows, inputs)
        kept_gap |= keep_back(alternative, followers, inputs.target, LADDER_MPS2)
        braked = _brake(alternative, adjustable, may_brake_for, stop_m, side, must_yield)
        if braked.unsolved.sum() < best.unsolved.sum():
            futures, best = alternative, braked
    return replace(best, braked=best.braked | kept_gap)


def _brake(
    futures: Futures,
    adjustable: BoolArray,
    may_brake_for: BoolArray,
    stop_m: FloatArray,
    side_m: FloatArray,
    must_yield: BoolArray,
) -> Braked:
    """Return *futures* braked for stop lines on the whole plan, then for other road users in the next 3 s."""
    stopped = brake(futures, adjustable, np.zeros_like(may_brake_for), stop_m)
    clear = brake_ahead(stopped.futures, adjustable, may_brake_for, stop_m, _LOOK_STEPS, side_m, must_yield)
    return Braked(clear.futures, stopped.braked | clear.braked, stopped.unsolved | clear.unsolved)


def _continue_previous(futures: Futures, rows: IntArray, inputs: SafeguardInput) -> None:
    """Let those of *rows* (V,) that have a previous plan continue it, in place."""
    for row in rows.tolist():
        if row in inputs.previous:
            futures.put(row, *inputs.previous[row])


def back_to_lane(futures: Futures, rows: IntArray, inputs: SafeguardInput) -> None:
    """Let those of *rows* (V,) that have a lane follow it, in place."""
    lanes = {row: lane for row in rows.tolist() if (lane := inputs.lanes[row]) is not None}
    if lanes:
        on_lane = np.array(list(lanes))
        present = futures.xy_m[on_lane, 0], futures.yaw_rad[on_lane, 0], futures.speed_mps[on_lane, 0]
        plans = follow(
            list(lanes.values()), *present, futures.size_m[on_lane, 0], futures.steps, futures.dt_s
        )
        futures.xy_m[on_lane, 1:], futures.yaw_rad[on_lane, 1:], futures.speed_mps[on_lane, 1:] = plans


def _depart_now(futures: Futures, row: int) -> None:
    """Leave out the wait at the beginning of a plan, in place.

    A vehicle would never depart if each new plan departed a second later again.
    """
    wait = int((futures.travelled_m()[row] > _MOVES_M).argmax()) - 1
    steps = np.minimum(np.arange(1, futures.steps + 1) + max(wait, 0), futures.steps)
    futures.put(row, futures.xy_m[row, steps], futures.yaw_rad[row, steps], futures.speed_mps[row, steps])


def stop_distances(futures: Futures, inputs: SafeguardInput, rows: BoolArray) -> FloatArray:
    """Return (N,) how far each of *rows* (N,) may drive before it must stop to yield or at a light; inf: no stop.

    No light stops an attacker. A light stops a vehicle only if its front is not over the line and the required
    deceleration is at most ``_RED_BRAKE_MPS2``, for a yellow light ``_YELLOW_BRAKE_MPS2``.
    """
    stop = np.where(rows, inputs.yield_stop_m, np.inf)
    for row in np.flatnonzero(rows & ~inputs.is_attacker).tolist():
        lane = inputs.lanes[row]
        for line_distance, link in lane.stops[:1] if lane is not None else ():
            distance = line_distance - 0.5 * futures.size_m[row, 0] - _BEFORE_LINE_M
            required = 0.5 * futures.speed_mps[row, 0] ** 2 / max(distance, 0.1)
            if required <= _max_brake_mps2(link.signal(inputs.signals)) and distance > -_BEFORE_LINE_M:
                stop[row] = min(stop[row], max(distance, 0.0))
    return stop


def _max_brake_mps2(state: str) -> float:
    """Return the deceleration up to which a driver stops at a light of *state*; negative: it need not stop."""
    if state in RED:
        return _RED_BRAKE_MPS2
    return _YELLOW_BRAKE_MPS2 if state in YELLOW else -1.0
