"""Simulate the three scenarios of UN Regulation No. 157 in discrete time, as in its tool, with a reference driver.

The scenarios are a cut-in, a cut-out and a braking lead vehicle on a straight lane, each for N cases at once. The speed
at an instant is computed from the states at the previous one, and x[i + 1] = x[i] + v[i + 1] · 0.1 s. Mattas et al.
2022, doi:10.1016/j.aap.2022.106743, describe the scenarios.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.metrics.reference.driver_models import (
    CRITICAL_TTC_S,
    FULL_BRAKE_MPS2,
    GRAVITY_MPS2,
    HUMAN,
    TIE_M,
    DriverModel,
    Situation,
    following_gap_m,
)
from advdiff_sumo.metrics.reference.reaction import Reaction, react

STEP_S = 0.1
STEPS = 350
LENGTH_M, WIDTH_M = 4.3, 1.9
LANE_M = 3.5
#: Lateral offset of the lead vehicle from which on the ego sees what is ahead of it.
PERCEIVED_M = 0.375
_RAMP_MPS = 0.15  # change of the lateral speed in a step: 1.5 m/s² for 0.1 s


@dataclass
class _Ego:
    """N ego vehicles on their lane: positions, speeds, accelerations, driver model and state of its reaction."""

    model: DriverModel
    x_m: FloatArray
    speed_mps: FloatArray
    accel_mps2: FloatArray
    reaction: Reaction

    @staticmethod
    def at(model: DriverModel, x_m: FloatArray, speed_mps: FloatArray) -> _Ego:
        return _Ego(model, x_m, speed_mps, np.zeros(x_m.shape), Reaction.fresh(model, x_m.shape))

    def facing(
        self, x_m: FloatArray, speed_mps: FloatArray, lateral_gap_m: FloatArray, lateral_mps: FloatArray
    ) -> Situation:
        """Return the situation with one other vehicle (N,) for each ego, whose centre is at *x_m*."""
        lengths = np.full(x_m.shape, 2.0 * LENGTH_M)
        gap = x_m - self.x_m - LENGTH_M
        return Situation(self.speed_mps, self.accel_mps2, speed_mps, gap, lateral_gap_m, lateral_mps, lengths)

    def step(self, demand_mps2: FloatArray, live: BoolArray) -> None:
        """Advance the egos for which *live* is set by one step."""
        self.reaction, accel = react(self.reaction, self.model, np.where(live, demand_mps2, 0.0), STEP_S)
        speed = np.maximum(self.speed_mps + accel * STEP_S, 0.0)
        self.accel_mps2 = (speed - self.speed_mps) / STEP_S
        self.speed_mps = speed
        self.x_m = np.where(live, self.x_m + speed * STEP_S, self.x_m)


def cut_in(
    model: DriverModel, ego_mps: FloatArray, other_mps: FloatArray, gap_m: FloatArray, lateral_mps: FloatArray
) -> BoolArray:
    """Return (N,) whether *model* collides with a vehicle that cuts in from the next lane.

    Args:
        model: driver of the ego.
        ego_mps: (N,) speed of the ego.
        other_mps: (N,) speed of the other vehicle.
        gap_m: (N,) bumper gap at the instant at which the other vehicle reaches its lateral speed.
        lateral_mps: (N,) lateral speed, constant until the lane change is complete; before, it grows by 1.5 m/s².
    """
    ramp = np.where(lateral_mps > 0.0, np.ceil(lateral_mps / _RAMP_MPS), 0)
    moving = np.where(lateral_mps > 0.0, lateral_mps, 1.0)
    steady = np.where(lateral_mps > 0.0, np.floor(LANE_M / (moving * STEP_S)) + 1, 0)

    def lateral(instant: int) -> FloatArray:
        growing = np.clip(_RAMP_MPS * (ramp + instant), 0.0, lateral_mps)
        return growing if instant < 0 else np.where(instant < steady, lateral_mps, 0.0)

    before = int(ramp.max(initial=0))
    y = LANE_M + STEP_S * sum((lateral(-k) for k in range(1, before + 1)), np.zeros(len(gap_m)))
    x = gap_m + LENGTH_M - STEP_S * ramp * other_mps
    ego = _Ego.at(model, -STEP_S * ramp * ego_mps, ego_mps)
    crash, entered, closed = (np.zeros(len(gap_m), dtype=np.bool_) for _ in range(3))
    for instant in range(-before, STEPS):
        live, w = np.asarray(instant >= -ramp), lateral(instant)
        met = ego.facing(x, other_mps, np.abs(y) - WIDTH_M, w)
        demand = model.demand(met)
        if model is HUMAN:  # if uncritical at the instant of entering the lane, the case is no collision
            inside = live & (met.lateral_gap_m <= TIE_M)
            closed |= inside & ~entered & (met.ttc_s > CRITICAL_TTC_S)
            entered |= inside
        ego.step(np.where(closed, 0.0, demand), live)
        x, y = np.where(live, x + other_mps * STEP_S, x), np.where(live, y - w * STEP_S, y)
        across = np.abs(y) < WIDTH_M - TIE_M
        crash |= live & across & (np.abs(x - ego.x_m) < LENGTH_M - TIE_M) & ~closed
    return crash


def cut_out(
    model: DriverModel, speed_mps: FloatArray, front_gap_m: FloatArray, lateral_mps: FloatArray
) -> BoolArray:
    """Return (N,) whether *model* collides with a standing vehicle, or with a lead vehicle that has hit it.

    Args:
        model: driver of the ego.
        speed_mps: (N,) speed of the ego and the lead vehicle, which it follows at its own gap.
        front_gap_m: (N,) bumper gap from the lead vehicle to the standing vehicle.
        lateral_mps: (N,) lateral speed of the lead vehicle; if it hits the standing vehicle, it stops.
    """
    count = len(speed_mps)
    leader = following_gap_m(model, speed_mps) + LENGTH_M
    standing = leader + front_gap_m + LENGTH_M
    y, pace = np.zeros(count), speed_mps.copy()
    ego = _Ego.at(model, np.zeros(count), speed_mps)
    crash, stopped = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    none, always = np.zeros(count), np.ones(count, dtype=np.bool_)
    for _ in range(STEPS):
        ahead = model.demand(ego.facing(standing, none, none - WIDTH_M, none))
        demand = np.where(y >= PERCEIVED_M - TIE_M, ahead, 0.0)
        behind = model.demand(ego.facing(leader, pace, y - WIDTH_M, none))
        ego.step(np.maximum(demand, np.where(stopped, behind, 0.0)), always)
        leader, y = leader + pace * STEP_S, np.where(stopped, y, y + np.abs(lateral_mps) * STEP_S)
        beside = y < WIDTH_M - TIE_M
        stopped |= beside & (standing - leader < LENGTH_M)
        pace = np.where(stopped, 0.0, pace)
        crash |= (standing - ego.x_m < LENGTH_M) | (beside & (leader - ego.x_m < LENGTH_M))
    return crash


def car_following(
    model: DriverModel, speed_mps: FloatArray, decel_g: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Return (N,) whether *model* runs into a lead vehicle that brakes to a stop, and (N,) the impact speeds in m/s.

    Args:
        model: driver of the ego, which follows at its own gap.
        speed_mps: (N,) initial speed of both vehicles.
        decel_g: (N,) deceleration of the lead vehicle in g.
    """
    count = len(speed_mps)
    leader, pace = following_gap_m(model, speed_mps) + LENGTH_M, speed_mps.copy()
    ego = _Ego.at(model, np.zeros(count), speed_mps)
    crash, impact = np.zeros(count, dtype=np.bool_), np.zeros(count)
    inside, none, always = np.full(count, -WIDTH_M), np.zeros(count), np.ones(count, dtype=np.bool_)
    for _ in range(STEPS):
        demand = model.demand(ego.facing(leader, pace, inside, none))
        ego.step(np.minimum(demand, FULL_BRAKE_MPS2), always)
        pace = np.maximum(pace - decel_g * GRAVITY_MPS2 * STEP_S, 0.0)
        leader = leader + pace * STEP_S
        touching = leader - ego.x_m < LENGTH_M
        impact = np.where(touching & ~crash, ego.speed_mps - pace, impact)
        crash |= touching
    return crash, impact
