"""Speed choices: IDM towards leaders, bends and stop lines, at several desired speeds, and plain braking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.planners.lane_graph.duties import Duties
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.path import SPACING_M, ReferencePath
from advdiff_sumo.planners.lane_graph.predict import STEP_S, Forecast
from advdiff_sumo.planners.lane_graph.variants import TargetState, Variant

_SIDE_MARGIN_M = 0.2
_STOP_HEADWAY_S = 0.5
_SHARES = (1.0, 0.75, 0.5, 0.25)
_EMERGENCY_JERK_MPS3 = 60.0
_BEHIND_M, _AHEAD_M = 15.0, 40.0


@dataclass(frozen=True)
class Idm:
    """The improved Intelligent Driver Model towards what is ahead, and towards where to stop.

    Attributes:
        accel_mps2: strongest acceleration.
        decel_mps2: comfortable deceleration.
        brake_mps2: strongest deceleration.
        min_gap_m: gap at standstill.
        headway_s: (2, 1) gap in time to what is ahead, and to where to stop.
        closing_mps2: what the square of speeds is divided by.
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
        self, speed: FloatArray, wish: FloatArray, gap: FloatArray, lead: FloatArray, alone: BoolArray
    ) -> FloatArray:
        """Return accelerations (2, C).

        Args:
            speed: (C,) own speeds.
            wish: (C,) desired ones.
            gap: (2, C) gaps.
            lead: (2, C) speeds of what is ahead.
            alone: (2, C) where nothing is.
        """
        a = self.accel_mps2
        ratio = speed / wish
        over = 1.0 - np.minimum(1.0 / np.maximum(ratio, 1e-3), 1.0)
        free = np.where(ratio < 1.0, a * (1.0 - ratio**4), -self.decel_mps2 * over * 3.0)
        closing = speed * (speed - lead) / self.closing_mps2
        desired = self.min_gap_m + np.maximum(speed * self.headway_s + closing, 0.0)
        z = desired / np.maximum(gap, 0.1)
        limit = np.maximum(a * (1.0 - np.minimum(z, 10.0) ** 2), -self.brake_mps2)
        follow = np.where(z < 1.0, np.maximum(free, 0.0) * (1.0 - z**4) + np.minimum(free, 0.0), limit)
        return np.where(alone, free, np.minimum(free, follow))


@dataclass(frozen=True)
class Modes:
    """C combinations of a lateral and a speed choice.

    Attributes:
        variant: (C,) index of the lateral choice.
        share: (C,) desired speed over the path's.
        stop_m: (C,) where the front must stop, inf for nowhere.
        brake_mps2: (C,) constant deceleration in place of IDM; 0 for IDM.
    """

    variant: IntArray
    share: FloatArray
    stop_m: FloatArray
    brake_mps2: FloatArray


def modes(variants: Sequence[Variant], duties: Sequence[Duties], options: LaneGraphOptions) -> Modes:
    """Return the combinations worth trying: all speeds in the lane, fewer beside it."""
    rows: list[tuple[int, float, float, float]] = []
    for v, (variant, duty) in enumerate(zip(variants, duties, strict=True)):
        plain = variant.side == 0 and variant.target_m == 0.0
        shares = _SHARES if plain else (_SHARES[0], _SHARES[2])
        rows += [(v, share, duty.stop_m, 0.0) for share in shares]
        rows += [(v, 1.0, place, 0.0) for place in duty.yield_m if place < duty.stop_m]
        if plain:
            rows += [(v, 1.0, duty.stop_m, brake) for brake in (2.0, 4.0, options.brake_mps2)]
    return Modes(*(np.array(column) for column in zip(*rows, strict=True)))


@dataclass(frozen=True)
class Leaders:
    """What is ahead on each of V lateral choices: N ways at T instants.

    Attributes:
        rear_m: (V, N, T) where the hindmost point along the path is; inf where not in the way.
        speed_mps: (V, N, T) speed along the path.
    """

    rear_m: FloatArray
    speed_mps: FloatArray


def leaders(variants: Sequence[Variant], state: TargetState, future: Forecast, now: Forecast) -> Leaders:
    """Return who is in the way of each lateral choice, now first and then at the instants of *future*."""
    xy = np.concatenate((now.xy_m, future.xy_m), axis=1)
    yaw = np.concatenate((now.yaw_rad, future.yaw_rad), axis=1)
    pace = np.concatenate((now.speed_mps, future.speed_mps), axis=1)
    half = 0.5 * future.size_m
    rear = np.full((len(variants), *yaw.shape), np.inf)
    speed = np.zeros_like(rear)
    reach = state.speed_mps * (STEP_S * future.yaw_rad.shape[1] + 1.0) + _AHEAD_M
    projected: dict[int, tuple[FloatArray, ...]] = {}
    for v, variant in enumerate(variants):
        if id(variant.path) not in projected:
            s, d = variant.path.project(xy, (variant.s_m - _BEHIND_M, variant.s_m + reach))
            turn = yaw - variant.path.yaw_at(s)
            cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
            along = half[:, :1] * cos + half[:, 1:] * sin
            across = half[:, :1] * sin + half[:, 1:] * cos
            projected[id(variant.path)] = s, d, along, across, pace * np.maximum(np.cos(turn), 0.0)
        s, d, along, across, forward = projected[id(variant.path)]
        clear = np.abs(d - variant.offset(s)) - across - 0.5 * state.width_m
        in_way = (clear < _SIDE_MARGIN_M) & (s[:, :1] > variant.s_m)
        rear[v] = np.where(in_way, s - along, np.inf)
        speed[v] = forward
    return Leaders(rear, speed)


def drive(
    variants: Sequence[Variant],
    choice: Modes,
    ahead: Leaders,
    state: TargetState,
    options: LaneGraphOptions,
    steps: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``s`` of the centre, speed and acceleration (C, T) of every combination.

    IDM in its improved form (Treiber & Kesting, Traffic Flow Dynamics, 2013, Sec. 11.3.7): a follower at its
    desired gap does not brake for its desired speed.
    """
    wishes = np.maximum(choice.share[:, None] * _paces(variants, options)[choice.variant], 0.5)  # (C, P)
    count, rows, last = len(choice.variant), np.arange(len(choice.variant)), wishes.shape[1] - 1
    s = np.array([variant.s_m for variant in variants])[choice.variant]
    speed, accel = np.full(count, state.speed_mps), np.full(count, state.accel_mps2)
    rear, theirs = (part[choice.variant] for part in _nearest(ahead))  # (C, T+1)
    idm = Idm.of(options)
    gaps, leads = np.empty((2, count)), np.zeros((2, count))  # to who is ahead, and to where to stop
    free = np.isinf(np.stack((rear, np.broadcast_to(choice.stop_m[:, None], rear.shape))))  # (2, C, T+1)
    plain, hard = choice.brake_mps2 > 0.0, choice.brake_mps2 > options.decel_mps2
    braking, urgent_mps2 = -choice.brake_mps2, -1.5 * options.decel_mps2
    gentle, sudden = options.jerk_mps3 * STEP_S, _EMERGENCY_JERK_MPS3 * STEP_S
    out = np.empty((3, count, steps))
    for k in range(steps):
        cell = np.minimum(np.maximum((s + 0.6 * speed) / SPACING_M, 0), last).astype(np.int64)
        np.subtract(rear[:, k], s + state.front_m, out=gaps[0])
        gaps[1] = choice.stop_m - s - state.front_m - options.stop_gap_m + options.min_gap_m
        leads[0] = theirs[:, k]
        towards = idm.accelerations(speed, wishes[rows, cell], gaps, leads, free[:, :, k])
        want = np.where(plain, braking, np.minimum(towards[0], towards[1]))
        jerk = np.where((want < urgent_mps2) | hard, sudden, gentle)
        accel = np.minimum(np.maximum(want, accel - jerk), accel + jerk)
        accel = np.minimum(np.maximum(accel, -options.brake_mps2), options.accel_mps2)
        accel[(speed <= 0.0) & (want <= 0.0)] = 0.0
        after = np.maximum(speed + accel * STEP_S, 0.0)
        s = s + 0.5 * (speed + after) * STEP_S
        accel = (after - speed) / STEP_S
        speed = after
        out[0, :, k], out[1, :, k], out[2, :, k] = s, speed, accel
    return out[0], out[1], out[2]


def _nearest(ahead: Leaders) -> tuple[FloatArray, FloatArray]:
    """Return where the nearest leader of each lateral choice is (V, T), inf for none, and its speed."""
    if ahead.rear_m.shape[1] == 0:
        shape = ahead.rear_m.shape[0], ahead.rear_m.shape[2]
        return np.full(shape, np.inf), np.zeros(shape)
    first = np.argmin(ahead.rear_m, axis=1)[:, None]
    rear, speed = (np.take_along_axis(part, first, axis=1)[:, 0] for part in (ahead.rear_m, ahead.speed_mps))
    return rear, speed


def _paces(variants: Sequence[Variant], options: LaneGraphOptions) -> FloatArray:
    """Return (V, P) the desired speed along each path, slow enough early enough for every bend."""
    pace = {path: _pace(path, options) for path in {variant.path for variant in variants}}
    out = np.empty((len(variants), max(len(row) for row in pace.values())))
    for v, variant in enumerate(variants):
        row = pace[variant.path]
        out[v, : len(row)], out[v, len(row) :] = row, row[-1]
    return out


def _pace(path: ReferencePath, options: LaneGraphOptions) -> FloatArray:
    bend = np.sqrt(options.lateral_mps2) * path.bend_mps
    top = np.minimum(bend, options.speed_factor * path.limit_mps)
    # v²(s) ≤ v²(s') + 2 b (s' − s) for every s' ahead: a running minimum of v² + 2 b s from the far end
    lift = 2.0 * 0.7 * options.decel_mps2 * SPACING_M * np.arange(len(top))
    reached = np.minimum.accumulate((top**2 + lift)[::-1])[::-1] - lift
    return np.asarray(np.sqrt(np.maximum(reached, 0.25)))
