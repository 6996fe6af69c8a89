"""Predict the other road users: along their lanes, as fast as bends, leaders, signals and right of way allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.planners.lane_graph.others import Others, PossibleWay
from advdiff_sumo.planners.lane_graph.path import SPACING_M, PathStack
from advdiff_sumo.planners.lane_graph.rules import Duty, rule_at

STEP_S = 0.25
_LATERAL_ACCEL_MPS2 = 3.5  # bounds the speed in bends
_SIGNAL_BRAKE_MPS2, _YIELD_BRAKE_MPS2 = 4.5, 3.0  # no stop is expected that needs more
_FOLLOW_BRAKE_MPS2, _FOLLOW_GAP_M = 3.0, 1.0  # behind a leader
_FADE_S = 1.0  # time constant of accelerations
_HARD_MPS2, _FADE_S_PER_MPS2, _MAX_FADE_S = 3.0, 2.0, 5.0  # harder braking fades more slowly
_MIN_DRIFT_MPS, _DRIFT_S = 0.25, 1.5  # lateral speed: ignored below, time constant
_ALIGN_M = 8.0  # distance over which a heading error fades
_EGO_WIDTH_M = 2.0


@dataclass(frozen=True)
class Forecast(KinematicStates):
    """Futures (N, T) on N possible ways at T instants ``STEP_S`` apart, the first one step from now.

    Attributes:
        other: (N,) index of the road user in :class:`Others`.
        weight: (N,) share of the way among those of its road user.
        s_m: (N, T) arc length of the centre along the way's path.
        size_m: (N, 2) length and width.
    """

    other: IntArray
    weight: FloatArray
    s_m: FloatArray
    size_m: FloatArray


@dataclass(frozen=True)
class Ego:
    """The target as the others see it.

    Attributes:
        xy_m: (2,) centre.
        speed_mps: speed.
        length_m: length.
        claims: links ahead that it will pass soon; vehicles that must yield there are expected to yield to it.
    """

    xy_m: FloatArray
    speed_mps: float
    length_m: float
    claims: tuple[Link, ...]


def forecast(
    road: RoadMap, scene: Scene, others: Others, ways: Sequence[PossibleWay], ego: Ego, steps: int
) -> Forecast:
    """Return the futures of *others* along *ways* over *steps* instants."""
    owner = np.array([way.other for way in ways], dtype=np.int64)
    stack = PathStack([way.path for way in ways])
    stop = np.array([_stop_m(road, scene, others, way, ego) for way in ways])
    gap, leader_mps = _leaders(stack, others, ways, ego)
    max_speed = _max_speeds(ways)
    driven, speed = _drive(
        others.speed_mps[owner],
        others.accel_mps2[owner],
        np.array([way.s_m for way in ways]),
        max_speed,
        stop,
        (gap, leader_mps),
        steps,
    )
    xy, yaw = _poses(stack, ways, others, driven)
    s0 = np.array([way.s_m for way in ways])
    return Forecast(
        xy_m=xy,
        yaw_rad=yaw,
        speed_mps=speed,
        other=owner,
        weight=np.array([way.weight for way in ways]),
        s_m=s0[:, None] + driven,
        size_m=others.size_m[owner],
    )


def _poses(
    stack: PathStack, ways: Sequence[PossibleWay], others: Others, driven_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return centres and headings (N, T) after the distances *driven_m* (N, T) along the ways.

    A road user that moves sideways, as in a lane change, drifts on for about ``_DRIFT_S``, except on junctions.
    """
    owner = np.array([way.other for way in ways], dtype=np.int64)
    s0, d0, error = (np.array([getattr(w, name) for w in ways]) for name in ("s_m", "d_m", "yaw_error_rad"))
    drift = others.speed_mps[owner] * np.sin(error)
    no_drift = np.array([way.on_junction for way in ways], dtype=np.bool_) | (np.abs(drift) < _MIN_DRIFT_MPS)
    drift = np.where(no_drift, 0.0, drift)
    time_s = STEP_S * np.arange(1, driven_m.shape[1] + 1)
    d = d0[:, None] + drift[:, None] * _DRIFT_S * (1.0 - np.exp(-time_s / _DRIFT_S))
    xy, yaw = stack.at(s0[:, None] + driven_m, d)
    return xy, yaw + error[:, None] * np.exp(-driven_m / _ALIGN_M)


def _stop_m(road: RoadMap, scene: Scene, others: Others, way: PossibleWay, ego: Ego) -> float:
    """Return the distance after which the road user must have stopped; inf if it need not stop."""
    front = 0.5 * float(others.size_m[way.other, 0])
    next_link = way.next_link(front)
    if next_link is None or next_link[1] < -1.0:
        return np.inf
    link, distance = next_link
    rule = rule_at(road, link, scene.signals)
    speed = float(others.speed_mps[way.other])
    braking = speed**2 / (2.0 * max(distance - 0.5, 0.1))
    claimed = any(c.junction_id == link.junction_id and c.request_index in rule.yields_to for c in ego.claims)
    must_yield = (claimed and not rule.in_turn) or (rule.duty is Duty.STOP_THEN_YIELD and speed > 0.5)
    must_stop = rule.duty in (Duty.STOP, Duty.CLEAR) and braking < _SIGNAL_BRAKE_MPS2
    return max(distance - 0.5, 0.0) if must_stop or (must_yield and braking < _YIELD_BRAKE_MPS2) else np.inf


def _leaders(
    stack: PathStack, others: Others, ways: Sequence[PossibleWay], ego: Ego
) -> tuple[FloatArray, FloatArray]:
    """Return the gap (N,) to the nearest road user ahead on each way (inf for none), and its speed (N,)."""
    owner = np.array([way.other for way in ways], dtype=np.int64)
    s0, d0 = (np.array([getattr(way, name) for way in ways])[:, None] for name in ("s_m", "d_m"))
    size = np.concatenate((others.size_m, [[ego.length_m, _EGO_WIDTH_M]]))
    speed = np.append(others.speed_mps, ego.speed_mps)
    s, d = stack.project(np.concatenate((others.xy_m, ego.xy_m[None])))  # (N, A + 1)
    own_size = others.size_m[owner]
    in_path = np.abs(d - d0) < 0.5 * (size[:, 1] + own_size[:, 1:])
    ahead = in_path & (s > s0 + 0.5) & (np.arange(len(speed)) != owner[:, None])
    gap = np.where(ahead, s - s0 - 0.5 * (size[:, 0] + own_size[:, :1]), np.inf)
    nearest = np.argmin(gap, axis=1)
    return gap[np.arange(len(ways)), nearest], speed[nearest]


def _max_speeds(ways: Sequence[PossibleWay]) -> FloatArray:
    """Return (N, P) the highest speed at each metre of each way's path: by curvature and speed limit."""
    max_speed = np.empty((len(ways), max((len(way.path.xy_m) for way in ways), default=1)))
    for n, way in enumerate(ways):
        bound = np.minimum(np.sqrt(_LATERAL_ACCEL_MPS2) * way.path.bend_mps, 1.1 * way.path.limit_mps)
        max_speed[n, : len(bound)], max_speed[n, len(bound) :] = bound, bound[-1]
    return max_speed


def _drive(
    speed: FloatArray,
    accel: FloatArray,
    s0: FloatArray,
    max_speed: FloatArray,
    stop: FloatArray,
    leader: tuple[FloatArray, FloatArray],
    steps: int,
) -> tuple[FloatArray, FloatArray]:
    """Return distance driven and speed (N, T) of N vehicles.

    Present *speed*, *accel* and arc length *s0*, and the distance *stop* within which to stop (inf for none), are
    (N,). *max_speed* (N, P) is for each metre of the paths. *leader* holds gap (inf for none) and speed, each (N,).
    """
    rows, driven, last_cell = np.arange(len(speed)), np.zeros(len(speed)), max_speed.shape[1] - 1
    speed_gain = accel * np.exp(-np.arange(steps)[:, None] * STEP_S / _fade_s(accel)) * STEP_S  # (T, N)
    leader_tail = leader[0] - _FOLLOW_GAP_M + leader[1] * np.arange(steps)[:, None] * STEP_S
    distances, speeds = np.empty((steps, len(speed))), np.empty((steps, len(speed)))
    for k in range(steps):
        cell = np.minimum(np.maximum((s0 + driven + 0.5 * speed) / SPACING_M, 0), last_cell).astype(np.int64)
        bound = max_speed[rows, cell]
        slowing = np.maximum(speed - 3.0 * STEP_S, bound)
        target = np.where(speed > bound, slowing, np.minimum(speed + speed_gain[k], bound))
        to_stop = np.maximum(stop - driven, 0.0)
        target = np.minimum(target, np.sqrt(2.0 * _SIGNAL_BRAKE_MPS2 * to_stop))
        to_leader = np.maximum(leader_tail[k] - driven, 0.0)
        target = np.minimum(target, leader[1] + np.sqrt(2.0 * _FOLLOW_BRAKE_MPS2 * to_leader))
        target = np.maximum(target, np.maximum(speed - 8.0 * STEP_S, 0.0))
        driven = driven + 0.5 * (speed + target) * STEP_S
        speed = target
        distances[k], speeds[k] = driven, speed
    return distances.T.copy(), speeds.T.copy()


def _fade_s(accel: FloatArray) -> FloatArray:
    """Return (N,) the time constants with which accelerations fade: the harder a vehicle brakes, the longer."""
    return np.clip(_FADE_S + _FADE_S_PER_MPS2 * (-accel - _HARD_MPS2), _FADE_S, _MAX_FADE_S)
