"""Whether what a planner returned is a plan: types, shapes, lengths, interval, and values that a vehicle can have."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.plan import Controls, Plan, Trajectory

_MAX_CONTROL_MPS2 = 50.0
_DIMENSIONS = {"accel_mps2": 1, "steer_rad": 1, "xy_m": 2, "yaw_rad": 1, "speed_mps": 1}


def plan_arrays(plan: Plan) -> tuple[str, ...]:
    """Return the names of the arrays that *plan* consists of."""
    return ("accel_mps2", "steer_rad") if isinstance(plan, Controls) else ("xy_m", "yaw_rad", "speed_mps")


def form_problem(plan: Plan, model_step_s: float, replan_every: int = 1) -> str:
    """Return what is wrong with the form of *plan*, as a sentence; "" where nothing is.

    Args:
        plan: from a planner; its fields may be anything.
        model_step_s: spacing of replanning instants.
        replan_every: of these instants to the next plan, to which this one must last.
    """
    arrays: dict[str, Any] = {name: getattr(plan, name) for name in plan_arrays(plan)}
    for name, array in arrays.items():
        problem = _array_problem(array, _DIMENSIONS[name])
        if problem:
            return f"{name} {problem}"
    if len({len(array) for array in arrays.values()}) > 1:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        return f"its arrays do not fit each other in shape: {shapes}"
    problem = interval_problem(plan.dt_s)
    if problem:
        return f"dt_s {problem}"
    steps = min(len(array) for array in arrays.values())
    return _length_problem(steps * plan.dt_s, model_step_s, replan_every)


def _length_problem(lasts_s: float, model_step_s: float, replan_every: int) -> str:
    next_s = model_step_s * replan_every
    if lasts_s >= next_s - 1e-9:
        return ""
    if replan_every == 1:
        return f"it lasts {lasts_s:g} s, less than one model step of {model_step_s:g} s, the time to the next plan"
    steps = f"sim.replan_every = {replan_every} model steps of {model_step_s:g} s"
    return f"it lasts {lasts_s:g} s, less than the {next_s:g} s to the next plan ({steps})"


def values_problem(plan: Plan) -> str:
    """Return what is wrong with the values of *plan*, whose form is right, wherever the vehicle is; "" for nothing."""
    finite = all(np.isfinite(getattr(plan, name)).all() for name in plan_arrays(plan))
    if not isinstance(plan, Controls):
        return "" if finite else "a trajectory that holds values that are not numbers"
    if not finite:
        return "controls that are not numbers"
    if _largest(plan.accel_mps2) > _MAX_CONTROL_MPS2:
        return f"an acceleration of {_largest(plan.accel_mps2):g} m/s², beyond {_MAX_CONTROL_MPS2:g}"
    if _largest(plan.steer_rad) >= 0.5 * np.pi:
        return f"a steering of {_largest(plan.steer_rad):g} rad, beyond 90°"
    return ""


def can_be_driven(plan: object, least_s: float) -> bool:
    """Return whether *plan* is one, of right form and values, and lasts *least_s*.

    Whether it jumps is for who knows the place.
    """
    if not isinstance(plan, Controls | Trajectory):
        return False
    return not form_problem(plan, least_s) and not values_problem(plan)


def in_float64(plan: Plan) -> Plan:
    """Return *plan*, whose form is right, in float64: what float32 or integers say is taken as it is."""
    arrays = {name: getattr(plan, name) for name in plan_arrays(plan)}
    if all(array.dtype == np.float64 for array in arrays.values()):
        return plan
    return replace(plan, **{name: array.astype(np.float64) for name, array in arrays.items()})


def interval_problem(dt_s: Any) -> str:
    """Return what is wrong with an interval between instants, as in :func:`form_problem`."""
    if isinstance(dt_s, bool) or not isinstance(dt_s, int | float | np.integer | np.floating):
        return f"is of type {type(dt_s).__name__}, not a number of seconds"
    if not (math.isfinite(dt_s) and dt_s > 0.0):
        return f"is {dt_s}, not a positive number of seconds"
    return ""


def _largest(values: FloatArray) -> float:
    return float(np.abs(values.astype(np.float64)).max())  # int8 has no 128


def _array_problem(array: Any, dimensions: int) -> str:
    if type(array) is not np.ndarray:  # a subclass may mask or change what is looked at
        return f"is of type {type(array).__name__}, not a NumPy array"
    if not (np.issubdtype(array.dtype, np.floating) or np.issubdtype(array.dtype, np.integer)):
        return f"holds {array.dtype}, not numbers"
    if array.ndim != dimensions or (dimensions == 2 and array.shape[1] != 2):
        return f"has shape {array.shape}, not {'(T, 2)' if dimensions == 2 else '(T,)'}"
    return ""
