"""Faults behind the planner: brakes that are weak or slow, and plans that are not made anew."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.polylines import stations_m
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.planners.defects.planted_fault import PlantedFault

_Bound = Callable[[float, float], float]
"""Deceleration that the brakes give, out of the one that was reached (m/s²) and the time since (s)."""


@dataclass(frozen=True)
class _Braking:
    """What the brakes did in the last plan.

    Attributes:
        at_s: when it began.
        dt_s: spacing.
        brake_mps2: (T,) decelerations, 0 or more, each reached at the end of its interval.
        before_mps2: deceleration when it began.
    """

    at_s: float
    dt_s: float
    brake_mps2: FloatArray
    before_mps2: float

    def reached(self, time_s: float, rise_mps3: float) -> float:
        """Return the deceleration at *time_s*, also amid an interval, when it builds up by *rise_mps3*."""
        since = time_s - self.at_s
        step = min(math.ceil(since / self.dt_s - 1e-6), len(self.brake_mps2)) - 1
        planned = float(self.brake_mps2[step]) if step >= 0 else self.before_mps2
        return min(planned, self.before_mps2 + rise_mps3 * since + 1e-9)


class WeakBrakes(PlantedFault):
    """The brakes give ``value`` m/s² at most."""

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Return the plan with no harder braking."""
        return _braked(plan, scene, 0.0, lambda *_: self.value)[0], memory


class SlowBrakes(PlantedFault):
    """The brakes need ``value`` seconds to build up to the strongest braking, evenly."""

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Return the plan with braking that builds up."""
        rise = Limits().brake_mps2 / self.value
        reached = memory.reached(scene.time_s, rise) if isinstance(memory, _Braking) else 0.0
        slow, brake = _braked(plan, scene, reached, lambda before, dt_s: before + rise * dt_s)
        return slow, _Braking(scene.time_s, plan.dt_s, brake, reached)


@dataclass(frozen=True)
class _Made:
    """A plan and when it was made."""

    plan: Plan
    at_s: float


class StuckReplanning(PlantedFault):
    """A plan is made only every ``value`` seconds and driven on in between; beyond its end at its last speed."""

    def held_plan(self, scene: Scene, memory: Any) -> Plan | None:
        """Return what is left of the last plan, as long as it was."""
        if not isinstance(memory, _Made) or scene.time_s - memory.at_s > self.value - 1e-6:
            return None
        return _rest(memory.plan, scene.time_s - memory.at_s)

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Keep the plan."""
        del memory
        return plan, _Made(plan, scene.time_s)


def _braked(plan: Plan, scene: Scene, reached: float, bound: _Bound) -> tuple[Plan, FloatArray]:
    """Return *plan* with decelerations (T,) within *bound*, and these."""
    if isinstance(plan, Controls):
        accel, brake = plan.accel_mps2.copy(), np.zeros(len(plan.accel_mps2))
        for k, wish in enumerate(plan.accel_mps2.tolist()):
            reached = brake[k] = min(max(-wish, 0.0), bound(reached, plan.dt_s))
            accel[k] = max(wish, -reached)
        return replace(plan, accel_mps2=accel), brake
    pace = max(float(scene.history.speed_mps[scene.target, -1]), 0.0)
    speed, brake = plan.speed_mps.copy(), np.zeros(len(plan.speed_mps))
    for k, wish in enumerate(plan.speed_mps.tolist()):
        wanted = max((pace - wish) / plan.dt_s, 0.0)
        reached = brake[k] = min(wanted, bound(reached, plan.dt_s))
        speed[k] = pace = wish if reached >= wanted else pace - reached * plan.dt_s
    faster = speed - plan.speed_mps
    if not faster.any():
        return plan, brake
    further = np.cumsum(0.5 * (faster + np.append(0.0, faster[:-1]))) * plan.dt_s
    return _further_on(plan, scene, speed, further), brake


def _further_on(plan: Trajectory, scene: Scene, speed: FloatArray, further_m: FloatArray) -> Trajectory:
    """Return *plan* with other speeds, *further_m* (T,) on along its way; straight on beyond its end."""
    row, history = scene.target, scene.history
    xy = np.concatenate((history.xy_m[row, -1:], plan.xy_m))
    yaw = np.unwrap(np.append(history.yaw_rad[row, -1], plan.yaw_rad))
    s = stations_m(xy)
    wish = s[1:] + further_m
    on = np.column_stack([np.interp(wish, s, xy[:, k]) for k in (0, 1)])
    on += np.maximum(wish - s[-1], 0.0)[:, None] * unit(np.asarray(yaw[-1]))
    return Trajectory(on, np.interp(wish, s, yaw), speed, plan.dt_s)


def _rest(plan: Plan, after_s: float) -> Plan:
    """Return *plan* from *after_s* on, equally long: the last inputs are held, or the last speed and heading."""
    steps = len(plan.accel_mps2) if isinstance(plan, Controls) else len(plan.speed_mps)
    if isinstance(plan, Controls):
        held = np.minimum(
            ((after_s + plan.dt_s * np.arange(steps)) / plan.dt_s + 1e-6).astype(np.int64), steps - 1
        )
        return replace(plan, accel_mps2=plan.accel_mps2[held], steer_rad=plan.steer_rad[held])
    known = plan.dt_s * np.arange(1, steps + 1)
    then = after_s + known
    xy = np.column_stack([np.interp(then, known, plan.xy_m[:, k]) for k in (0, 1)])
    yaw = np.interp(then, known, np.unwrap(plan.yaw_rad))
    speed = np.interp(then, known, plan.speed_mps)
    gone = np.maximum(then - known[-1], 0.0) * speed
    return Trajectory(xy + gone[:, None] * unit(yaw), yaw, speed, plan.dt_s)
