"""Generate speed profiles: IDM towards leaders, bends and stop lines at several speeds, and plain braking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.planners.lane_graph.duties import Duties
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.path import SPACING_M, ReferencePath, slowed_ahead
from advdiff_sumo.planners.lane_graph.predict import STEP_S, Forecast
from advdiff_sumo.planners.lane_graph.variants import TargetState, Variant

_SIDE_MARGIN_M = 0.2  # a vehicle with less lateral clearance is in the way
_STOP_HEADWAY_S = 0.5  # time gap to a stop line
_SPEED_SHARES = (1.0, 0.75, 0.5, 0.25)  # of the path's desired speed
_EMERGENCY_JERK_MPS3 = 60.0
_BEHIND_M, _AHEAD_M = 15.0, 40.0  # vehicles are projected onto so much of the path, plus the distance driven


@dataclass(frozen=True)
class Idm:
    """The improved Intelligent Driver Model for two obstacles at once: the leader (row 0) and the stop line (row 1).

    Attributes:
        accel_mps2: strongest acceleration.
        decel_mps2: comfortable deceleration.
        brake_mps2: strongest deceleration.
        min_gap_m: gap at standstill.
        headway_s: (2, 1) time gaps to leader and stop line.
        closing_mps2: denominator of the closing term, 2 √(a b).
    """

    accel_mps2: float
    decel_mps2: float
    brake_mps2: float
    min_gap_m: float
    headway_s: FloatArray
    closing_mps2: float

    @staticmethod
    def of(options: LaneGraphOptions) -> Idm:
        """Return the model of *options*."""
        a, b = options.accel_mps2, options.decel_mps2
        headway = np.array([[options.time_headway_s], [_STOP_HEADWAY_S]])
        return Idm(a, b, options.brake_mps2, options.min_gap_m, headway, float(2.0 * np.sqrt(a * b)))

    def accelerations(
        self, speed: FloatArray, desired: FloatArray, gap: FloatArray, lead: FloatArray, clear: BoolArray
    ) -> FloatArray:
        """Return accelerations (2, C).

        Args:
            speed: (C,) own speeds.
            desired: (C,) desired speeds.
            gap: (2, C) gaps to leader and stop line.
            lead: (2, C) their speeds.
            clear: (2, C) True where there is none.
        """
        a = self.accel_mps2
        ratio = speed / desired
        overspeed = 1.0 - np.minimum(1.0 / np.maximum(ratio, 1e-3), 1.0)
        free = np.where(ratio < 1.0, a * (1.0 - ratio**4), -self.decel_mps2 * overspeed * 3.0)
        closing = speed * (speed - lead) / self.closing_mps2
        desired_gap = self.min_gap_m + np.maximum(speed * self.headway_s + closing, 0.0)
        z = desired_gap / np.maximum(gap, 0.1)
        brake = np.maximum(a * (1.0 - np.minimum(z, 10.0) ** 2), -self.brake_mps2)
        follow = np.where(z < 1.0, np.maximum(free, 0.0) * (1.0 - z**4) + np.minimum(free, 0.0), brake)
        return np.where(clear, free, np.minimum(free, follow))


@dataclass(frozen=True)
class Combinations:
    """C combinations of a lateral choice with a speed choice.

    Attributes:
        variant: (C,) index of the lateral choice.
        share: (C,) desired speed as a share of the path's.
        stop_m: (C,) arc length at which the front must stop, inf for none.
        brake_mps2: (C,) constant deceleration that replaces IDM; 0 for IDM.
    """

    variant: IntArray
    share: FloatArray
    stop_m: FloatArray
    brake_mps2: FloatArray


def combinations(
    variants: Sequence[Variant], duties: Sequence[Duties], options: LaneGraphOptions
) -> Combinations:
    """Return the combinations to try: all speed choices for the middle of the lane, fewer for other lateral choices."""
    rows: list[tuple[int, float, float, float]] = []
    for v, (variant, duty) in enumerate(zip(variants, duties, strict=True)):
        keeps_lane = variant.side == 0 and variant.target_m == 0.0
        shares = _SPEED_SHARES if keeps_lane else (_SPEED_SHARES[0], _SPEED_SHARES[2])
        rows += [(v, share, duty.stop_m, 0.0) for share in shares]
        rows += [(v, 1.0, yield_m, 0.0) for yield_m in duty.yield_m if yield_m < duty.stop_m]
        if keeps_lane:
            rows += [(v, 1.0, duty.stop_m, brake) for brake in (2.0, 4.0, options.brake_mps2)]
    return Combinations(*(np.array(column) for column in zip(*rows, strict=True)))


@dataclass(frozen=True)
class Leaders:
    """Vehicles ahead on each of V lateral choices: N possible ways at T instants.

    Attributes:
        rear_m: (V, N, T) arc length of the vehicle's rear along the path; inf if it is not in the way.
        speed_mps: (V, N, T) its speed along the path.
    """

    rear_m: FloatArray
    speed_mps: FloatArray


def leaders(variants: Sequence[Variant], state: TargetState, future: Forecast, now: Forecast) -> Leaders:
    """Return the vehicles in the way of each lateral choice, at present and then at the instants of *future*."""
    xy = np.concatenate((now.xy_m, future.xy_m), axis=1)
    yaw = np.concatenate((now.yaw_rad, future.yaw_rad), axis=1)
    speeds = np.concatenate((now.speed_mps, future.speed_mps), axis=1)
    half = 0.5 * future.size_m
    rear = np.full((len(variants), *yaw.shape), np.inf)
    speed = np.zeros_like(rear)
    reach = state.speed_mps * (STEP_S * future.yaw_rad.shape[1] + 1.0) + _AHEAD_M
    projected: dict[int, tuple[FloatArray, ...]] = {}
    for v, variant in enumerate(variants):
        if id(variant.path) not in projected:
            s, d = variant.path.project(xy, (variant.s_m - _BEHIND_M, variant.s_m + reach))
            yaw_error = yaw - variant.path.yaw_at(s)
            cos, sin = np.abs(np.cos(yaw_error)), np.abs(np.sin(yaw_error))
            along = half[:, :1] * cos + half[:, 1:] * sin
            across = half[:, :1] * sin + half[:, 1:] * cos
            projected[id(variant.path)] = s, d, along, across, speeds * np.maximum(np.cos(yaw_error), 0.0)
        s, d, along, across, speed_along = projected[id(variant.path)]
        clearance = np.abs(d - variant.offset(s)) - across - 0.5 * state.width_m
        in_way = (clearance < _SIDE_MARGIN_M) & (s[:, :1] > variant.s_m)
        rear[v] = np.where(in_way, s - along, np.inf)
        speed[v] = speed_along
    return Leaders(rear, speed)


def drive(
    variants: Sequence[Variant],
    combos: Combinations,
    ahead: Leaders,
    state: TargetState,
    options: LaneGraphOptions,
    steps: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return arc length of the centre, speed and acceleration (C, T) of each combination.

    IDM in its improved form (Treiber & Kesting, Traffic Flow Dynamics, 2013, Sec. 11.3.7): a follower at its
    desired gap does not brake to get to its desired speed.
    """
    desired = np.maximum(
        combos.share[:, None] * _path_speeds(variants, options)[combos.variant], 0.5
    )  # (C, P)
    count, rows, last_cell = len(combos.variant), np.arange(len(combos.variant)), desired.shape[1] - 1
    s = np.array([variant.s_m for variant in variants])[combos.variant]
    speed, accel = np.full(count, state.speed_mps), np.full(count, state.accel_mps2)
    rear, leader_speed = (x[combos.variant] for x in _nearest(ahead))  # (C, T+1)
    idm = Idm.of(options)
    gaps, obstacle_speed = np.empty((2, count)), np.zeros((2, count))  # to leader and stop line
    clear = np.isinf(np.stack((rear, np.broadcast_to(combos.stop_m[:, None], rear.shape))))  # (2, C, T+1)
    is_braking, is_emergency = combos.brake_mps2 > 0.0, combos.brake_mps2 > options.decel_mps2
    braking, urgent_mps2 = -combos.brake_mps2, -1.5 * options.decel_mps2
    jerk_step, emergency_step = options.jerk_mps3 * STEP_S, _EMERGENCY_JERK_MPS3 * STEP_S
    states = np.empty((3, count, steps))
    for k in range(steps):
        cell = np.minimum(np.maximum((s + 0.6 * speed) / SPACING_M, 0), last_cell).astype(np.int64)
        np.subtract(rear[:, k], s + state.front_m, out=gaps[0])
        gaps[1] = combos.stop_m - s - state.front_m - options.stop_gap_m + options.min_gap_m
        obstacle_speed[0] = leader_speed[:, k]
        idm_accel = idm.accelerations(speed, desired[rows, cell], gaps, obstacle_speed, clear[:, :, k])
        wanted_accel = np.where(is_braking, braking, np.minimum(idm_accel[0], idm_accel[1]))
        max_change = np.where((wanted_accel < urgent_mps2) | is_emergency, emergency_step, jerk_step)
        accel = np.minimum(np.maximum(wanted_accel, accel - max_change), accel + max_change)
        accel = np.minimum(np.maximum(accel, -options.brake_mps2), options.accel_mps2)
        accel[(speed <= 0.0) & (wanted_accel <= 0.0)] = 0.0
        next_speed = np.maximum(speed + accel * STEP_S, 0.0)
        s = s + 0.5 * (speed + next_speed) * STEP_S
        accel = (next_speed - speed) / STEP_S
        speed = next_speed
        states[0, :, k], states[1, :, k], states[2, :, k] = s, speed, accel
    return states[0], states[1], states[2]


def _nearest(ahead: Leaders) -> tuple[FloatArray, FloatArray]:
    """Return the rear of the nearest leader of each lateral choice (V, T), inf for none, and its speed (V, T)."""
    if ahead.rear_m.shape[1] == 0:
        shape = ahead.rear_m.shape[0], ahead.rear_m.shape[2]
        return np.full(shape, np.inf), np.zeros(shape)
    nearest = np.argmin(ahead.rear_m, axis=1)[:, None]
    rear, speed = (np.take_along_axis(x, nearest, axis=1)[:, 0] for x in (ahead.rear_m, ahead.speed_mps))
    return rear, speed


def _path_speeds(variants: Sequence[Variant], options: LaneGraphOptions) -> FloatArray:
    """Return (V, P) the desired speed at each metre of each path, low enough ahead of every bend."""
    by_path = {path: _path_speed(path, options) for path in {variant.path for variant in variants}}
    speeds = np.empty((len(variants), max(len(row) for row in by_path.values())))
    for v, variant in enumerate(variants):
        row = by_path[variant.path]
        speeds[v, : len(row)], speeds[v, len(row) :] = row, row[-1]
    return speeds


def _path_speed(path: ReferencePath, options: LaneGraphOptions) -> FloatArray:
    """Return (P,) the desired speed at each metre of *path*."""
    bend_speed = np.sqrt(options.lateral_mps2) * path.bend_mps
    bound = np.minimum(bend_speed, options.speed_factor * path.limit_mps)
    return slowed_ahead(bound, 0.7 * options.decel_mps2, 0.5)
