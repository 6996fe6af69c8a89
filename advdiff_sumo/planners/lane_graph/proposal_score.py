"""Score each combination: collisions, right of way, clearance, gaps, progress, comfort, lane, route."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners, separation
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.planners.lane_graph.duties import Duties, Foe
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.others import Others, PossibleWay
from advdiff_sumo.planners.lane_graph.predict import STEP_S, Forecast
from advdiff_sumo.planners.lane_graph.profiles import Combinations
from advdiff_sumo.planners.lane_graph.variants import TargetState, Variant

# Weights of the costs, which have no unit.
_COLLISION, _COLLISION_FADE_S = 300.0, 4.0  # a later collision costs less: e-fold in 4 s
_OVERRUN = 60.0  # per m beyond a line at which the target must stop
_CLOSE, _PRECEDENCE, _UNSAFE_GAP = 4.0, 150.0, 200.0
_PROGRESS, _ACCEL, _JERK, _LATERAL = 12.0, 0.25, 0.02, 0.1
_SLIDE, _SLIDE_RATIO = 4.0, 1.6  # per m/s, above 1.6 times the comfortable lateral acceleration
_CHANGE, _CHANGE_UNDERWAY, _SHIFT = 1.6, 0.3, 1.0  # lane change, one already begun, shift in the lane (per m)
_ROUTE, _ROUTE_NEAR_M, _ROUTE_FAR_M = 7.0, 40.0, 160.0  # wrong lane for the route; grows near its end


@dataclass(frozen=True)
class ProposalStates(KinematicStates):
    """C futures of the target at T instants, (C, T).

    Attributes:
        s_m: (C, T) arc lengths of the centre along the paths.
        accel_mps2: (C, T) accelerations.
    """

    s_m: FloatArray
    accel_mps2: FloatArray


def collision_cost(
    candidates: ProposalStates,
    state: TargetState,
    future: Forecast,
    ignored: BoolArray,
    options: LaneGraphOptions,
) -> FloatArray:
    """Return (C,) the cost of the costliest overlap with each possible way, and of small clearances.

    Args:
        candidates: the target's futures.
        state: the target at present.
        future: predicted states of the others.
        ignored: (C, N) possible ways of followers, which must keep their distance from the target.
        options: margins.
    """
    cost = np.zeros(len(candidates.s_m))
    offset = candidates.xy_m[:, None] - future.xy_m[None]  # (C, N, T, 2)
    reach_m = 0.5 * (np.hypot(*future.size_m.T) + np.hypot(state.length_m, state.width_m))
    near = offset[..., 0] ** 2 + offset[..., 1] ** 2 < (reach_m[None, :, None] + options.courtesy_m) ** 2
    near &= ~ignored[:, :, None]
    c, n, t = np.nonzero(near)
    if not len(c):
        return cost
    own = corners(candidates.xy_m[c, t], candidates.yaw_rad[c, t], np.array([state.length_m, state.width_m]))
    other = corners(future.xy_m[n, t], future.yaw_rad[n, t], future.size_m[n])
    gap = separation(own, other)
    impact = 1.0 + candidates.speed_mps[c, t] ** 2 / 50.0
    fade = np.exp(-STEP_S * t / _COLLISION_FADE_S) * future.weight[n] ** 0.5
    hit_cost = np.zeros(near.shape)
    hit_cost[c, n, t] = np.where(gap < options.margin_m, _COLLISION * impact * fade, 0.0)
    speed_share = np.minimum(candidates.speed_mps[c, t] / 2.0, 1.0)
    close_cost = np.zeros(near.shape)
    close_cost[c, n, t] = _CLOSE * fade * speed_share * np.clip(options.courtesy_m - gap, 0.0, 1.0)
    return np.asarray(hit_cost.max(-1).sum(-1) + close_cost.max(-1).sum(-1))


def followers(
    variants: Sequence[Variant], combos: Combinations, state: TargetState, others: Others, future: Forecast
) -> tuple[BoolArray, FloatArray]:
    """Return which possible ways follow the target in each combination (C, N), and the cost of unsafe cut-ins (C,).

    A follower in the target's lane must keep its distance. A lane change needs a gap in which the follower can
    react and then brake (as in RSS, arXiv:1708.06374, with mild parameters).
    """
    behind = np.zeros((len(variants), len(future.other)), dtype=np.bool_)
    unsafe = np.zeros(len(variants))
    for v, variant in enumerate(variants):
        # shifts within the lane have the same followers as its middle
        if v > 0 and variant.side == 0 and variants[0].path is variant.path:
            behind[v] = behind[0]
            continue
        s, d = variant.path.project(others.xy_m)
        gap = variant.s_m - s - 0.5 * (state.length_m + others.size_m[:, 0])
        beside = np.abs(d - variant.d_m) < 0.5 * (state.width_m + others.size_m[:, 1])
        same_way = np.cos(others.yaw_rad - variant.path.yaw_at(s)) > 0.5
        behind[v] = (beside & same_way & (s < variant.s_m - 0.25 * state.length_m))[future.other]
        if variant.side == 0:
            continue
        in_new_lane = (np.abs(d) < 1.6) & same_way & (s < variant.s_m + 0.5 * state.length_m) & ~beside
        speed_excess = np.maximum(others.speed_mps**2 - state.speed_mps**2, 0.0)
        safe_gap = 1.5 + 0.5 * others.speed_mps + speed_excess / 5.0
        shortfall = np.where(in_new_lane, np.clip(safe_gap - gap, 0.0, 5.0) / 5.0, 0.0)
        unsafe[v] = _UNSAFE_GAP * float(shortfall.max(initial=0.0))
    return behind[combos.variant], unsafe[combos.variant]


def precedence_cost(
    variants: Sequence[Variant],
    combos: Combinations,
    duties: Sequence[Duties],
    candidates: ProposalStates,
    state: TargetState,
    others: Others,
    ways: Sequence[PossibleWay],
    future: Forecast,
    committed: frozenset[tuple[str, str]],
    waited_s: float,
    options: LaneGraphOptions,
) -> FloatArray:
    """Return (C,) the cost of taking the right of way from other vehicles.

    Vehicles that stand still are ignored once the target has waited long enough, or is committed to passing its
    stop line: they wait for another vehicle, perhaps for the target.
    """
    cost = np.zeros(len(combos.variant))
    now_m = np.array([variant.s_m for variant in variants])[combos.variant]
    for v, duty in enumerate(duties):
        foes, gaps = _relevant(duty.foes, others, ways, committed, waited_s, options)
        if not foes or any(duty is earlier for earlier in duties[:v]):
            continue
        rows = np.flatnonzero(np.array([duty is other for other in duties])[combos.variant])
        conflict = _conflicts(candidates, rows, now_m[rows], foes, gaps, state, others, ways, future)
        for foe, in_conflict in zip(foes, conflict.T, strict=True):
            cost[rows] += _PRECEDENCE * future.weight[foe.way] ** 0.5 * in_conflict
    return cost


def _relevant(
    foes: Sequence[Foe],
    others: Others,
    ways: Sequence[PossibleWay],
    committed: frozenset[tuple[str, str]],
    waited_s: float,
    options: LaneGraphOptions,
) -> tuple[list[Foe], FloatArray]:
    """Return the *foes* that are not ignored, and the time gap (s) to keep to each."""
    relevant, gaps = list[Foe](), list[float]()
    for foe in foes:
        is_committed = (foe.link.from_lane, foe.link.to_lane) in committed
        if bool(others.standing[ways[foe.way].other]) and (is_committed or waited_s > options.patience_s):
            continue
        relevant.append(foe)
        gaps.append(options.gap_s * (0.4 if is_committed else 1.0))
    return relevant, np.array(gaps)


def _conflicts(
    candidates: ProposalStates,
    rows: np.ndarray[tuple[int], np.dtype[np.int64]],
    now_m: FloatArray,
    foes: Sequence[Foe],
    gap_s: FloatArray,
    state: TargetState,
    others: Others,
    ways: Sequence[PossibleWay],
    future: Forecast,
) -> FloatArray:
    """Return (R, F) 1 where the target is in the conflict area together with a foe, or shortly before or after it."""
    s, speed = candidates.s_m[rows], candidates.speed_mps[rows]
    begin, end = np.array([[foe.origin_m + m for m in foe.zone.own_m] for foe in foes]).T
    bounds = np.concatenate((begin - state.front_m, end + state.front_m))[None]
    enters, leaves = np.split(_time_at(now_m, s, speed, bounds), 2, axis=1)
    arrival, departure, foe_speed = _occupancy(foes, others, ways, future)
    mean = speed.mean(-1)[:, None]
    merged = enters + state.length_m / np.maximum(mean, 2.0) + np.maximum(foe_speed - mean, 0.0) / 2.0
    leaves = np.where([foe.zone.merges for foe in foes], merged, leaves)
    reached = np.isfinite(enters) & (enters < STEP_S * s.shape[1] + 1.0)
    return np.asarray(
        reached & (enters - 0.3 * gap_s < departure) & (arrival < leaves + gap_s), dtype=np.float64
    )


def _occupancy(
    foes: Sequence[Foe], others: Others, ways: Sequence[PossibleWay], future: Forecast
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (F,) the earliest time at which each foe enters the conflict area, when it leaves it, and its speed."""
    way_index = [foe.way for foe in foes]
    speed = others.speed_mps[[ways[k].other for k in way_index]]
    arrival, cleared_m = np.empty(len(foes)), np.empty(len(foes))
    for k, foe in enumerate(foes):
        way = ways[foe.way]
        length, is_standing = float(others.size_m[way.other, 0]), bool(others.standing[way.other])
        arrival[k] = _earliest_arrival(foe.to_stop_m + foe.zone.other_m[0], float(speed[k]), is_standing, way)
        cleared_m[k] = way.s_m + foe.to_stop_m + foe.zone.other_m[0 if foe.zone.merges else 1] + length
    now = np.array([ways[k].s_m for k in way_index])
    departure = _time_at(now, future.s_m[way_index], future.speed_mps[way_index], cleared_m[:, None])
    return arrival, departure[:, 0], speed


def _earliest_arrival(distance_m: float, speed_mps: float, is_standing: bool, way: PossibleWay) -> float:
    """Return the least time in which a vehicle drives *distance_m*, if it speeds up to the limit at 1.5 m/s²."""
    if distance_m <= 0.0:
        return 0.0
    limit = max(float(way.path.limit_mps[0]), speed_mps, 1.0)
    accel, delay = 1.5, (1.5 if is_standing else 0.0)
    speed_up_s = (limit - speed_mps) / accel
    speed_up_m = speed_mps * speed_up_s + 0.5 * accel * speed_up_s**2
    if distance_m < speed_up_m:
        return delay + float(np.sqrt(speed_mps**2 + 2.0 * accel * distance_m) - speed_mps) / accel
    return delay + speed_up_s + (distance_m - speed_up_m) / limit


def _time_at(now_m: FloatArray, s_m: FloatArray, speed_mps: FloatArray, goal_m: FloatArray) -> FloatArray:
    """Return (R, G) the time at which the arc length *s_m* (R, T) reaches each *goal_m* (R or 1, G).

    The arc length never falls. It is *now_m* (R,) at present, one step before the first instant, and linear
    between instants. The time is 0 if the goal is already reached. Beyond the horizon the last speed holds.
    """
    steps = s_m.shape[1]
    steps_before = np.count_nonzero(s_m[:, None] < goal_m[..., None], axis=2)
    first = np.minimum(steps_before, steps - 1)
    s = np.concatenate((now_m[:, None], s_m), axis=1)
    before, after = np.take_along_axis(s, first, axis=1), np.take_along_axis(s, first + 1, axis=1)
    share = np.maximum((goal_m - before) / np.maximum(after - before, 1e-9), 0.0)
    extra_s = (goal_m - s_m[:, -1:]) / np.maximum(speed_mps[:, -1:], 0.1)
    beyond_s = np.where(speed_mps[:, -1:] > 0.3, STEP_S * steps + extra_s, np.inf)
    return np.where(steps_before < steps, STEP_S * (first + share), beyond_s)


def overrun_cost(
    combos: Combinations, duties: Sequence[Duties], candidates: ProposalStates, state: TargetState
) -> FloatArray:
    """Return (C,) the cost of not stopping before a line at which the target must stop."""
    stop = np.array([duty.stop_m for duty in duties])[combos.variant]
    over = candidates.s_m[:, -1] + state.front_m - stop
    return np.asarray(_OVERRUN * np.clip(over + 0.5, 0.0, 2.0))


def driving_cost(
    variants: Sequence[Variant],
    combos: Combinations,
    candidates: ProposalStates,
    state: TargetState,
    target_lane: str | None,
    options: LaneGraphOptions,
) -> FloatArray:
    """Return (C,) the cost of little progress, discomfort, leaving the middle of the lane, and the wrong lane."""
    start = np.array([variant.s_m for variant in variants])
    progress = candidates.s_m[:, -1] - start[combos.variant]
    horizon_s = STEP_S * candidates.s_m.shape[1]
    limit = np.array([float(v.path.limit_mps[min(int(v.s_m), len(v.path.limit_mps) - 1)]) for v in variants])
    desired_m = np.maximum(options.speed_factor * limit.max() * horizon_s, 5.0)
    accel = candidates.accel_mps2
    jerk = np.diff(accel, axis=1, prepend=state.accel_mps2) / STEP_S
    yaw_rate = np.diff(np.unwrap(candidates.yaw_rad, axis=1), axis=1) / STEP_S
    lateral = np.abs(yaw_rate * candidates.speed_mps[:, 1:])
    slide = np.maximum(lateral - _SLIDE_RATIO * options.lateral_mps2, 0.0)
    cost = _PROGRESS * (1.0 - progress / desired_m) + _ACCEL * (accel**2).mean(-1)
    cost += _JERK * np.abs(jerk).mean(-1) + _LATERAL * lateral.max(-1) + _SLIDE * STEP_S * slide.sum(-1)
    lane_cost = np.array([_lane_cost(v, target_lane, state, options) for v in variants])
    return np.asarray(cost + lane_cost[combos.variant])


def _lane_cost(
    variant: Variant, target_lane: str | None, state: TargetState, options: LaneGraphOptions
) -> float:
    """Return the cost of the lateral choice itself: shift, lane change, and lane changes that the route still needs."""
    chain, cost = variant.chain, _SHIFT * abs(variant.target_m)
    underway = variant.side != 0 and target_lane in chain.lanes
    if variant.side != 0:
        cost += _CHANGE_UNDERWAY if underway else _CHANGE
        if not underway and (not options.lane_changes and chain.follows_route):
            cost += 2.0 * _CHANGE
    end_m = variant.path.length_m if not chain.follows_route else _next_stop(variant)
    changes_left = abs(chain.changes) if chain.changes else float(not chain.follows_route)
    room_m = (end_m - variant.s_m - state.front_m) / max(changes_left, 1.0)
    urgency = 1.0 - (room_m - _ROUTE_NEAR_M) / (_ROUTE_FAR_M - _ROUTE_NEAR_M)
    return float(cost + changes_left * (0.5 + _ROUTE * np.clip(urgency, 0.0, 1.5)))


def _next_stop(variant: Variant) -> float:
    """Return the arc length of the next stop line, or the end of the path."""
    return next((line for line in variant.path.stop_m if line > variant.s_m), variant.path.length_m)
