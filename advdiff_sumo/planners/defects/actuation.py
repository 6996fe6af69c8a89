"""Faults behind the planner: weak or slow brakes, and plans that are not replaced in time."""

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
from advdiff_sumo.planners.defects.planted_defect import PlantedDefect

_Bound = Callable[[float, float], float]
"""(Present deceleration in m/s², time step in s) → largest deceleration after the step in m/s²."""


@dataclass(frozen=True)
class _Braking:
    """Braking in the last plan.

    Attributes:
        at_s: time at which the plan began.
        dt_s: time step.
        brake_mps2: (T,) decelerations, 0 or more, each reached at the end of its interval.
        before_mps2: deceleration at the beginning of the plan.
    """

    at_s: float
    dt_s: float
    brake_mps2: FloatArray
    before_mps2: float

    def reached(self, time_s: float, rise_mps3: float) -> float:
        """Return the deceleration at *time_s*, also within an interval, if it rises by at most *rise_mps3*."""
        elapsed_s = time_s - self.at_s
        step = min(math.ceil(elapsed_s / self.dt_s - 1e-6), len(self.brake_mps2)) - 1
        planned = float(self.brake_mps2[step]) if step >= 0 else self.before_mps2
        return min(planned, self.before_mps2 + rise_mps3 * elapsed_s + 1e-9)


class WeakBrakes(PlantedDefect):
    """The brakes reach at most ``value`` m/s²."""

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Return the plan with weaker braking."""
        return _braked(plan, scene, 0.0, lambda *_: self.value)[0], memory


class SlowBrakes(PlantedDefect):
    """The brakes need ``value`` seconds to reach the strongest braking, at a constant rate."""

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Return the plan with braking that builds up."""
        rise_mps3 = Limits().brake_mps2 / self.value
        reached = memory.reached(scene.time_s, rise_mps3) if isinstance(memory, _Braking) else 0.0
        braked, brake = _braked(plan, scene, reached, lambda before, dt_s: before + rise_mps3 * dt_s)
        return braked, _Braking(scene.time_s, plan.dt_s, brake, reached)


@dataclass(frozen=True)
class _StoredPlan:
    """A plan and the time at which it was made."""

    plan: Plan
    at_s: float


class StuckReplanning(PlantedDefect):
    """A new plan is made only every ``value`` seconds; in between, the last plan is continued."""

    def held_plan(self, scene: Scene, memory: Any) -> Plan | None:
        """Return the last plan from the present time on; None if a new one is due."""
        if not isinstance(memory, _StoredPlan) or scene.time_s - memory.at_s > self.value - 1e-6:
            return None
        return _continued(memory.plan, scene.time_s - memory.at_s)

    def act(self, plan: Plan, scene: Scene, memory: Any) -> tuple[Plan, Any]:
        """Store the plan."""
        del memory
        return plan, _StoredPlan(plan, scene.time_s)


def _braked(plan: Plan, scene: Scene, reached: float, bound: _Bound) -> tuple[Plan, FloatArray]:
    """Return *plan* with its deceleration limited by *bound*, and these decelerations (T,)."""
    if isinstance(plan, Controls):
        accel, brake = plan.accel_mps2.copy(), np.zeros(len(plan.accel_mps2))
        for k, planned in enumerate(plan.accel_mps2.tolist()):
            reached = brake[k] = min(max(-planned, 0.0), bound(reached, plan.dt_s))
            accel[k] = max(planned, -reached)
        return replace(plan, accel_mps2=accel), brake
    speed_now = max(float(scene.history.speed_mps[scene.target, -1]), 0.0)
    speed, brake = plan.speed_mps.copy(), np.zeros(len(plan.speed_mps))
    for k, planned in enumerate(plan.speed_mps.tolist()):
        planned_brake = max((speed_now - planned) / plan.dt_s, 0.0)
        reached = brake[k] = min(planned_brake, bound(reached, plan.dt_s))
        speed[k] = speed_now = planned if reached >= planned_brake else speed_now - reached * plan.dt_s
    excess = speed - plan.speed_mps
    if not excess.any():
        return plan, brake
    extra_m = np.cumsum(0.5 * (excess + np.append(0.0, excess[:-1]))) * plan.dt_s
    return _with_speeds(plan, scene, speed, extra_m), brake


def _with_speeds(plan: Trajectory, scene: Scene, speed: FloatArray, extra_m: FloatArray) -> Trajectory:
    """Return *plan* with new speeds and *extra_m* (T,) farther along its path; straight on beyond its end."""
    row, history = scene.target, scene.history
    xy = np.concatenate((history.xy_m[row, -1:], plan.xy_m))
    yaw = np.unwrap(np.append(history.yaw_rad[row, -1], plan.yaw_rad))
    s = stations_m(xy)
    new_s = s[1:] + extra_m
    new_xy = np.column_stack([np.interp(new_s, s, xy[:, k]) for k in (0, 1)])
    new_xy += np.maximum(new_s - s[-1], 0.0)[:, None] * unit(np.asarray(yaw[-1]))
    return Trajectory(new_xy, np.interp(new_s, s, yaw), speed, plan.dt_s)


def _continued(plan: Plan, after_s: float) -> Plan:
    """Return *plan* from *after_s* on, as long as before; beyond its end the last input, or speed and heading, hold."""
    steps = len(plan.accel_mps2) if isinstance(plan, Controls) else len(plan.speed_mps)
    if isinstance(plan, Controls):
        index = np.minimum(
            ((after_s + plan.dt_s * np.arange(steps)) / plan.dt_s + 1e-6).astype(np.int64), steps - 1
        )
        return replace(plan, accel_mps2=plan.accel_mps2[index], steer_rad=plan.steer_rad[index])
    plan_s = plan.dt_s * np.arange(1, steps + 1)
    times_s = after_s + plan_s
    xy = np.column_stack([np.interp(times_s, plan_s, plan.xy_m[:, k]) for k in (0, 1)])
    yaw = np.interp(times_s, plan_s, np.unwrap(plan.yaw_rad))
    speed = np.interp(times_s, plan_s, plan.speed_mps)
    beyond_m = np.maximum(times_s - plan_s[-1], 0.0) * speed
    return Trajectory(xy + beyond_m[:, None] * unit(yaw), yaw, speed, plan.dt_s)
