"""Where the others will be: along their lanes at a pace that bends, leaders, signals and right of way allow."""

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
_LATERAL_ACCEL_MPS2 = 3.5
_SIGNAL_BRAKE_MPS2, _YIELD_BRAKE_MPS2 = 4.5, 3.0
_FOLLOW_BRAKE_MPS2, _FOLLOW_GAP_M = 3.0, 1.0
_FADE_S, _DRIFT_S = 1.0, 1.5
_HARD_MPS2, _LASTS_S, _LONGEST_S = 3.0, 2.0, 5.0
_MIN_DRIFT_MPS = 0.25
_ALIGN_M = 8.0
_EGO_WIDTH_M = 2.0


@dataclass(frozen=True)
class Forecast(KinematicStates):
    """Futures (N, T) of N ways at T instants ``STEP_S`` apart, the first one step from now.

    Attributes:
        other: (N,) index in :class:`Others`.
        weight: (N,) share of the way.
        s_m: (N, T) centres along each way's path; distance driven off the lanes.
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
        claims: its links ahead that it will pass soon, so that who must yield to it is expected to.
    """

    xy_m: FloatArray
    speed_mps: float
    length_m: float
    claims: tuple[Link, ...]


def forecast(
    road: RoadMap, scene: Scene, others: Others, ways: Sequence[PossibleWay], ego: Ego, steps: int
) -> Forecast:
    """Return the futures of *others* along *ways* over *steps* instants."""
    index = np.array([way.other for way in ways], dtype=np.int64)
    stack = PathStack([way.path for way in ways])
    stop = np.array([_stop_m(road, scene, others, way, ego) for way in ways])
    gap, leader_mps = _leaders(stack, others, ways, ego)
    pace = _paces(ways)
    driven, speed = _drive(
        others.speed_mps[index],
        others.accel_mps2[index],
        np.array([w.s_m for w in ways]),
        pace,
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
        other=index,
        weight=np.array([way.weight for way in ways]),
        s_m=s0[:, None] + driven,
        size_m=others.size_m[index],
    )


def _poses(
    stack: PathStack, ways: Sequence[PossibleWay], others: Others, driven_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return centres and headings (N, T): along the lanes, with the drift to the side of a change of lanes."""
    index = np.array([way.other for way in ways], dtype=np.int64)
    s0, d0, error = (np.array([getattr(w, name) for w in ways]) for name in ("s_m", "d_m", "yaw_error_rad"))
    drift = others.speed_mps[index] * np.sin(error)
    steady = np.array([way.on_junction for way in ways], dtype=np.bool_) | (np.abs(drift) < _MIN_DRIFT_MPS)
    drift = np.where(steady, 0.0, drift)
    time = STEP_S * np.arange(1, driven_m.shape[1] + 1)
    d = d0[:, None] + drift[:, None] * _DRIFT_S * (1.0 - np.exp(-time / _DRIFT_S))
    xy, yaw = stack.at(s0[:, None] + driven_m, d)
    return xy, yaw + error[:, None] * np.exp(-driven_m / _ALIGN_M)


def _stop_m(road: RoadMap, scene: Scene, others: Others, way: PossibleWay, ego: Ego) -> float:
    """Return how far the road user may drive until it must have stopped; inf for no end."""
    front = 0.5 * float(others.size_m[way.other, 0])
    next_link = way.next_link(front)
    if next_link is None or next_link[1] < -1.0:
        return np.inf
    link, distance = next_link
    rule = rule_at(road, link, scene.signals)
    speed = float(others.speed_mps[way.other])
    brake = speed**2 / (2.0 * max(distance - 0.5, 0.1))
    claimed = any(c.junction_id == link.junction_id and c.request_index in rule.yields_to for c in ego.claims)
    yields = (claimed and not rule.in_turn) or (rule.duty is Duty.STOP_THEN_YIELD and speed > 0.5)
    stops = rule.duty in (Duty.STOP, Duty.CLEAR) and brake < _SIGNAL_BRAKE_MPS2
    return max(distance - 0.5, 0.0) if stops or (yields and brake < _YIELD_BRAKE_MPS2) else np.inf


def _leaders(
    stack: PathStack, others: Others, ways: Sequence[PossibleWay], ego: Ego
) -> tuple[FloatArray, FloatArray]:
    """Return the gap (N,) to the next road user on each way (inf for none) and that one's speed."""
    index = np.array([way.other for way in ways], dtype=np.int64)
    s0, d0 = (np.array([getattr(way, name) for way in ways])[:, None] for name in ("s_m", "d_m"))
    size = np.concatenate((others.size_m, [[ego.length_m, _EGO_WIDTH_M]]))
    speed = np.append(others.speed_mps, ego.speed_mps)
    s, d = stack.project(np.concatenate((others.xy_m, ego.xy_m[None])))  # (N, A + 1)
    own = others.size_m[index]
    near = np.abs(d - d0) < 0.5 * (size[:, 1] + own[:, 1:])
    ahead = near & (s > s0 + 0.5) & (np.arange(len(speed)) != index[:, None])
    gap = np.where(ahead, s - s0 - 0.5 * (size[:, 0] + own[:, :1]), np.inf)
    first = np.argmin(gap, axis=1)
    return gap[np.arange(len(ways)), first], speed[first]


def _paces(ways: Sequence[PossibleWay]) -> FloatArray:
    """Return (N, P) the highest sensible speed by distance along each way's path."""
    pace = np.empty((len(ways), max((len(way.path.xy_m) for way in ways), default=1)))
    for n, way in enumerate(ways):
        bend = np.minimum(np.sqrt(_LATERAL_ACCEL_MPS2) * way.path.bend_mps, 1.1 * way.path.limit_mps)
        pace[n, : len(bend)], pace[n, len(bend) :] = bend, bend[-1]
    return pace


def _drive(
    speed: FloatArray,
    accel: FloatArray,
    s0: FloatArray,
    pace: FloatArray,
    stop: FloatArray,
    leader: tuple[FloatArray, FloatArray],
    steps: int,
) -> tuple[FloatArray, FloatArray]:
    """Return distance driven and speed (N, T)."""
    rows, driven, last = np.arange(len(speed)), np.zeros(len(speed)), pace.shape[1] - 1
    pushes = accel * np.exp(-np.arange(steps)[:, None] * STEP_S / _fade_s(accel)) * STEP_S  # (T, N)
    tails = leader[0] - _FOLLOW_GAP_M + leader[1] * np.arange(steps)[:, None] * STEP_S
    distances, speeds = np.empty((steps, len(speed))), np.empty((steps, len(speed)))
    for k in range(steps):
        cell = np.minimum(np.maximum((s0 + driven + 0.5 * speed) / SPACING_M, 0), last).astype(np.int64)
        bound = pace[rows, cell]
        slower = np.maximum(speed - 3.0 * STEP_S, bound)
        wish = np.where(speed > bound, slower, np.minimum(speed + pushes[k], bound))
        room = np.maximum(stop - driven, 0.0)
        wish = np.minimum(wish, np.sqrt(2.0 * _SIGNAL_BRAKE_MPS2 * room))
        free = np.maximum(tails[k] - driven, 0.0)
        wish = np.minimum(wish, leader[1] + np.sqrt(2.0 * _FOLLOW_BRAKE_MPS2 * free))
        wish = np.maximum(wish, np.maximum(speed - 8.0 * STEP_S, 0.0))
        driven = driven + 0.5 * (speed + wish) * STEP_S
        speed = wish
        distances[k], speeds[k] = driven, speed
    return distances.T.copy(), speeds.T.copy()


def _fade_s(accel: FloatArray) -> FloatArray:
    """Return (N,) in which time accelerations fade: whoever brakes hard goes on with it, the harder the longer."""
    return np.clip(_FADE_S + _LASTS_S * (-accel - _HARD_MPS2), _FADE_S, _LONGEST_S)
