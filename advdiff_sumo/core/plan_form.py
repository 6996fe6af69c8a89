"""Check the form and the values of a planner's plan: types, shapes, lengths, interval, and possible values."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.plan import Controls, Plan, Trajectory

_MAX_CONTROL_MPS2 = 50.0
_MAX_INTERVAL_S = 10.0
"""Greatest interval between the instants of a plan; a greater one is most likely in milliseconds."""
_MOST_STEPS = 10_000
"""Most steps of a plan; to drive more, as the simulation does ahead, takes minutes and gigabytes."""
#: Number of dimensions of each array of a plan.
_DIMENSIONS = {"accel_mps2": 1, "steer_rad": 1, "xy_m": 2, "yaw_rad": 1, "speed_mps": 1}


def plan_arrays(plan: Plan) -> tuple[str, ...]:
    """Return the names of the arrays of *plan*."""
    return ("accel_mps2", "steer_rad") if isinstance(plan, Controls) else ("xy_m", "yaw_rad", "speed_mps")


def form_problem(plan: Plan, model_step_s: float, replan_every: int = 1) -> str:
    """Return the problem with the form of *plan*, as a sentence; "" if there is none.

    Args:
        plan: plan of a planner; its fields may have any type.
        model_step_s: spacing of the model's instants.
        replan_every: number of these steps until the next plan; this one must last as long.
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
    if steps > _MOST_STEPS:
        return f"it has {steps} steps, over {_MOST_STEPS}; plan some seconds"
    return _length_problem(steps * plan.dt_s, model_step_s, replan_every)


def _length_problem(duration_s: float, model_step_s: float, replan_every: int) -> str:
    next_s = model_step_s * replan_every
    if duration_s >= next_s - 1e-9:
        return ""
    if replan_every == 1:
        return f"it lasts {duration_s:g} s, less than one model step of {model_step_s:g} s, the time to the next plan"
    steps = f"sim.replan_every = {replan_every} model steps of {model_step_s:g} s"
    return f"it lasts {duration_s:g} s, less than the {next_s:g} s to the next plan ({steps})"


def values_problem(plan: Plan) -> str:
    """Return the problem with the values of *plan*, whose form is valid; "" if there is none.

    The position of the vehicle is not considered.
    """
    place = _not_finite(plan)
    if not isinstance(plan, Controls):
        return f"a trajectory that holds values that are not numbers: {place}" if place else ""
    if place:
        return f"controls that are not numbers: {place}"
    if _largest(plan.accel_mps2) > _MAX_CONTROL_MPS2:
        return f"an acceleration of {_largest(plan.accel_mps2):g} m/s², beyond {_MAX_CONTROL_MPS2:g}"
    if _largest(plan.steer_rad) >= 0.5 * np.pi:
        return f"a steering of {_largest(plan.steer_rad):g} rad, beyond 90°"
    return ""


def can_be_driven(plan: object, least_s: float) -> bool:
    """Return whether *plan* is a plan of valid form and values that lasts at least *least_s*.

    It may still begin with a jump, which only the vehicle's position can show.
    """
    if not isinstance(plan, Controls | Trajectory):
        return False
    return not form_problem(plan, least_s) and not values_problem(plan)


def in_float64(plan: Plan) -> Plan:
    """Return *plan*, whose form is valid, with its arrays converted to float64."""
    arrays = {name: getattr(plan, name) for name in plan_arrays(plan)}
    if all(array.dtype == np.float64 for array in arrays.values()):
        return plan
    return replace(plan, **{name: array.astype(np.float64) for name, array in arrays.items()})


def interval_problem(dt_s: Any) -> str:
    """Return the problem with an interval between instants, as in :func:`form_problem`."""
    if isinstance(dt_s, bool) or not isinstance(dt_s, int | float | np.integer | np.floating):
        return f"is of type {type(dt_s).__name__}, not a number of seconds"
    if not (math.isfinite(dt_s) and dt_s > 0.0):
        return f"is {dt_s}, not a positive number of seconds"
    if dt_s > _MAX_INTERVAL_S:
        return f"is {dt_s:g} s, over {_MAX_INTERVAL_S:g} s; give it in seconds, not in milliseconds"
    return ""


def _not_finite(plan: Plan) -> str:
    """Return the name, index and value of the first entry of *plan* that is not finite; "" if there is none."""
    for name in plan_arrays(plan):
        values = getattr(plan, name)
        indices = np.argwhere(~np.isfinite(values))
        if len(indices):
            index = tuple(indices[0])
            return f"{name}[{', '.join(map(str, index))}] is {values[index]}"
    return ""


def _largest(values: FloatArray) -> float:
    return float(np.abs(values.astype(np.float64)).max())  # in int8 the absolute value of -128 overflows


def _array_problem(array: Any, dimensions: int) -> str:
    if type(array) is not np.ndarray:  # a subclass may mask or change values
        return f"is of type {type(array).__name__}, not a NumPy array"
    if not (np.issubdtype(array.dtype, np.floating) or np.issubdtype(array.dtype, np.integer)):
        return f"holds {array.dtype}, not numbers"
    if array.ndim != dimensions or (dimensions == 2 and array.shape[1] != 2):
        return f"has shape {array.shape}, not {'(T, 2)' if dimensions == 2 else '(T,)'}"
    return ""
