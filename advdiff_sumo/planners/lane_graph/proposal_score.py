"""What each combination costs: collisions, right of way, clearance, gaps, progress, comfort, lane, route."""

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
from advdiff_sumo.planners.lane_graph.profiles import Modes
from advdiff_sumo.planners.lane_graph.variants import TargetState, Variant

_COLLISION, _COLLISION_FADE_S = 300.0, 4.0
_OVERRUN = 60.0
_CLOSE, _PRECEDENCE, _UNSAFE_GAP = 4.0, 150.0, 200.0
_PROGRESS, _ACCEL, _JERK, _LATERAL = 12.0, 0.25, 0.02, 0.1
_SLIDE, _SLIDES_FROM = 4.0, 1.6  # per m/s, from so many times the lateral acceleration of comfort on
_CHANGE, _CHANGE_UNDERWAY, _NUDGE = 1.6, 0.3, 1.0
_ROUTE, _ROUTE_NEAR_M, _ROUTE_FAR_M = 7.0, 40.0, 160.0


@dataclass(frozen=True)
class ProposalStates(KinematicStates):
    """C futures of the target at T instants, (C, T).

    Attributes:
        s_m: (C, T) centres along the paths.
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
    """Return (C,) the cost of the first overlap with each way, and of coming close.

    Args:
        candidates: the futures.
        state: the target now.
        future: where the others will be.
        ignored: (C, N) ways that follow the target and must keep their distance.
        options: margins.
    """
    cost = np.zeros(len(candidates.s_m))
    delta = candidates.xy_m[:, None] - future.xy_m[None]  # (C, N, T, 2)
    reach = 0.5 * (np.hypot(*future.size_m.T) + np.hypot(state.length_m, state.width_m))
    near = delta[..., 0] ** 2 + delta[..., 1] ** 2 < (reach[None, :, None] + options.courtesy_m) ** 2
    near &= ~ignored[:, :, None]
    c, n, t = np.nonzero(near)
    if not len(c):
        return cost
    own = corners(candidates.xy_m[c, t], candidates.yaw_rad[c, t], np.array([state.length_m, state.width_m]))
    theirs = corners(future.xy_m[n, t], future.yaw_rad[n, t], future.size_m[n])
    gap = separation(own, theirs)
    impact = 1.0 + candidates.speed_mps[c, t] ** 2 / 50.0
    fade = np.exp(-STEP_S * t / _COLLISION_FADE_S) * future.weight[n] ** 0.5
    hit = np.zeros(near.shape)
    hit[c, n, t] = np.where(gap < options.margin_m, _COLLISION * impact * fade, 0.0)
    moving = np.minimum(candidates.speed_mps[c, t] / 2.0, 1.0)
    close = np.zeros(near.shape)
    close[c, n, t] = _CLOSE * fade * moving * np.clip(options.courtesy_m - gap, 0.0, 1.0)
    return np.asarray(hit.max(-1).sum(-1) + close.max(-1).sum(-1))


def followers(
    variants: Sequence[Variant], choice: Modes, state: TargetState, others: Others, future: Forecast
) -> tuple[BoolArray, FloatArray]:
    """Return who follows each combination (C, N) and what cutting in too close before someone costs (C,).

    In the lane, whoever is behind must keep the distance. For a change of lanes the gap behind must suffice for
    the follower to brake from its reaction on (as in RSS, arXiv:1708.06374, with mild figures).
    """
    behind = np.zeros((len(variants), len(future.other)), dtype=np.bool_)
    unsafe = np.zeros(len(variants))
    for v, variant in enumerate(variants):
        if (
            v > 0 and variant.side == 0 and variants[0].path is variant.path
        ):  # beside the same vehicles as the first
            behind[v] = behind[0]
            continue
        s, d = variant.path.project(others.xy_m)
        gap = variant.s_m - s - 0.5 * (state.length_m + others.size_m[:, 0])
        beside = np.abs(d - variant.d_m) < 0.5 * (state.width_m + others.size_m[:, 1])
        heading = np.cos(others.yaw_rad - variant.path.yaw_at(s)) > 0.5
        behind[v] = (beside & heading & (s < variant.s_m - 0.25 * state.length_m))[future.other]
        if variant.side == 0:
            continue
        entering = (np.abs(d) < 1.6) & heading & (s < variant.s_m + 0.5 * state.length_m) & ~beside
        faster = np.maximum(others.speed_mps**2 - state.speed_mps**2, 0.0)
        enough = 1.5 + 0.5 * others.speed_mps + faster / 5.0
        short = np.where(entering, np.clip(enough - gap, 0.0, 5.0) / 5.0, 0.0)
        unsafe[v] = _UNSAFE_GAP * float(short.max(initial=0.0))
    return behind[choice.variant], unsafe[choice.variant]


def precedence_cost(
    variants: Sequence[Variant],
    choice: Modes,
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
    """Return (C,) the cost of taking the right of way from somebody.

    Vehicles that have stood for two seconds while the target waited, or when it has set out, are let be: they
    wait for somebody else, perhaps for the target.
    """
    cost = np.zeros(len(choice.variant))
    now_m = np.array([variant.s_m for variant in variants])[choice.variant]
    for v, rule in enumerate(duties):
        foes, gaps = _heeded(rule.foes, others, ways, committed, waited_s, options)
        if not foes or any(rule is known for known in duties[:v]):
            continue
        rows = np.flatnonzero(np.array([rule is other for other in duties])[choice.variant])
        took = _takes(candidates, rows, now_m[rows], foes, gaps, state, others, ways, future)
        for foe, taken in zip(foes, took.T, strict=True):
            cost[rows] += _PRECEDENCE * future.weight[foe.way] ** 0.5 * taken
    return cost


def _heeded(
    foes: Sequence[Foe],
    others: Others,
    ways: Sequence[PossibleWay],
    committed: frozenset[tuple[str, str]],
    waited_s: float,
    options: LaneGraphOptions,
) -> tuple[list[Foe], FloatArray]:
    """Return the *foes* that are not let be, and the gap (s) that each of them is left."""
    heeded, gaps = list[Foe](), list[float]()
    for foe in foes:
        known = (foe.link.from_lane, foe.link.to_lane) in committed
        if bool(others.standing[ways[foe.way].other]) and (known or waited_s > options.patience_s):
            continue
        heeded.append(foe)
        gaps.append(options.gap_s * (0.4 if known else 1.0))
    return heeded, np.array(gaps)


def _takes(
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
    """Return (R, F) 1 where the target would be in the conflict area while a foe is, or too shortly before."""
    s, speed = candidates.s_m[rows], candidates.speed_mps[rows]
    begin, end = np.array([[foe.origin_m + own for own in foe.zone.own_m] for foe in foes]).T
    goals = np.concatenate((begin - state.front_m, end + state.front_m))[None]
    enters, leaves = np.split(_time_at(now_m, s, speed, goals), 2, axis=1)
    soon, late, pace = _times_of(foes, others, ways, future)
    mean = speed.mean(-1)[:, None]
    behind = enters + state.length_m / np.maximum(mean, 2.0) + np.maximum(pace - mean, 0.0) / 2.0
    leaves = np.where([foe.zone.merges for foe in foes], behind, leaves)
    inside = np.isfinite(enters) & (enters < STEP_S * s.shape[1] + 1.0)
    return np.asarray(inside & (enters - 0.3 * gap_s < late) & (soon < leaves + gap_s), dtype=np.float64)


def _times_of(
    foes: Sequence[Foe], others: Others, ways: Sequence[PossibleWay], future: Forecast
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (F,) when each foe can be in the conflict area at the soonest, when it leaves it, and its speed."""
    index = [foe.way for foe in foes]
    pace = others.speed_mps[[ways[k].other for k in index]]
    soon, clears = np.empty(len(foes)), np.empty(len(foes))
    for k, foe in enumerate(foes):
        way = ways[foe.way]
        length, stands = float(others.size_m[way.other, 0]), bool(others.standing[way.other])
        soon[k] = _soonest(foe.to_stop_m + foe.zone.other_m[0], float(pace[k]), stands, way)
        clears[k] = way.s_m + foe.to_stop_m + foe.zone.other_m[0 if foe.zone.merges else 1] + length
    now = np.array([ways[k].s_m for k in index])
    late = _time_at(now, future.s_m[index], future.speed_mps[index], clears[:, None])
    return soon, late[:, 0], pace


def _soonest(distance_m: float, speed_mps: float, stands: bool, way: PossibleWay) -> float:
    """Return when a vehicle can be *distance_m* further on: it keeps its speed or picks up to the limit."""
    if distance_m <= 0.0:
        return 0.0
    limit = max(float(way.path.limit_mps[0]), speed_mps, 1.0)
    accel, delay = 1.5, (1.5 if stands else 0.0)
    up = (limit - speed_mps) / accel
    within = speed_mps * up + 0.5 * accel * up**2
    if distance_m < within:
        return delay + float(np.sqrt(speed_mps**2 + 2.0 * accel * distance_m) - speed_mps) / accel
    return delay + up + (distance_m - within) / limit


def _time_at(now_m: FloatArray, s_m: FloatArray, speed_mps: FloatArray, goal_m: FloatArray) -> FloatArray:
    """Return (R, G) when ``s`` (R, T), which never falls, reaches each *goal_m* (R or 1, G).

    It is *now_m* (R,) now, one step before the first of its instants, and straight between two of them. 0 if it has
    reached the goal already, beyond the horizon at the last speed.
    """
    steps = s_m.shape[1]
    passed = np.count_nonzero(s_m[:, None] < goal_m[..., None], axis=2)
    first = np.minimum(passed, steps - 1)
    way = np.concatenate((now_m[:, None], s_m), axis=1)
    before, after = np.take_along_axis(way, first, axis=1), np.take_along_axis(way, first + 1, axis=1)
    share = np.maximum((goal_m - before) / np.maximum(after - before, 1e-9), 0.0)
    rest = (goal_m - s_m[:, -1:]) / np.maximum(speed_mps[:, -1:], 0.1)
    late = np.where(speed_mps[:, -1:] > 0.3, STEP_S * steps + rest, np.inf)
    return np.where(passed < steps, STEP_S * (first + share), late)


def overrun_cost(
    choice: Modes, duties: Sequence[Duties], candidates: ProposalStates, state: TargetState
) -> FloatArray:
    """Return (C,) the cost of passing a line at which one must stop, by braking too little."""
    stop = np.array([duty.stop_m for duty in duties])[choice.variant]
    over = candidates.s_m[:, -1] + state.front_m - stop
    return np.asarray(_OVERRUN * np.clip(over + 0.5, 0.0, 2.0))


def driving_cost(
    variants: Sequence[Variant],
    choice: Modes,
    candidates: ProposalStates,
    state: TargetState,
    target_lane: str | None,
    options: LaneGraphOptions,
) -> FloatArray:
    """Return (C,) the cost of little progress, discomfort, leaving the lane's middle, and the wrong lane."""
    start = np.array([variant.s_m for variant in variants])
    ahead = candidates.s_m[:, -1] - start[choice.variant]
    horizon = STEP_S * candidates.s_m.shape[1]
    limit = np.array([float(v.path.limit_mps[min(int(v.s_m), len(v.path.limit_mps) - 1)]) for v in variants])
    wanted = np.maximum(options.speed_factor * limit.max() * horizon, 5.0)
    accel = candidates.accel_mps2
    jerk = np.diff(accel, axis=1, prepend=state.accel_mps2) / STEP_S
    turn = np.diff(np.unwrap(candidates.yaw_rad, axis=1), axis=1) / STEP_S
    lateral = np.abs(turn * candidates.speed_mps[:, 1:])
    slide = np.maximum(lateral - _SLIDES_FROM * options.lateral_mps2, 0.0)
    cost = _PROGRESS * (1.0 - ahead / wanted) + _ACCEL * (accel**2).mean(-1)
    cost += _JERK * np.abs(jerk).mean(-1) + _LATERAL * lateral.max(-1) + _SLIDE * STEP_S * slide.sum(-1)
    sideways = np.array([_sideways_cost(v, target_lane, state, options) for v in variants])
    return np.asarray(cost + sideways[choice.variant])


def _sideways_cost(
    variant: Variant, target_lane: str | None, state: TargetState, options: LaneGraphOptions
) -> float:
    cost = _NUDGE * abs(variant.target_m)
    underway = variant.side != 0 and target_lane in variant.chain.lanes
    if variant.side != 0:
        cost += _CHANGE_UNDERWAY if underway else _CHANGE
        if not underway and (not options.lane_changes and variant.chain.serves):
            cost += 2.0 * _CHANGE
    end = variant.path.length_m if not variant.chain.serves else _next_stop(variant)
    count = abs(variant.chain.changes) if variant.chain.changes else float(not variant.chain.serves)
    left = (end - variant.s_m - state.front_m) / max(count, 1.0)
    near = 1.0 - (left - _ROUTE_NEAR_M) / (_ROUTE_FAR_M - _ROUTE_NEAR_M)
    return float(cost + count * (0.5 + _ROUTE * np.clip(near, 0.0, 1.5)))


def _next_stop(variant: Variant) -> float:
    return next((line for line in variant.path.stop_m if line > variant.s_m), variant.path.length_m)
