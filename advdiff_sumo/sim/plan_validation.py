"""Check plans before SUMO gets them; SUMO itself accepts NaN and any jump without a message."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.errors import PlanRefusedError
from advdiff_sumo.core.joint_plan_form import (
    farthest_m,
    joint_form_problem,
    joint_values_problem,
    starts_too_far,
)
from advdiff_sumo.core.plan import MAX_SPEED_MPS, Controls, JointPlan, Plan, Trajectory
from advdiff_sumo.core.plan_form import form_problem, in_float64, values_problem


def check_plan(plan: Plan, xy_m: FloatArray, model_step_s: float, owner: str, replan_every: int = 1) -> Plan:
    """Return a planner's plan in float64, and refuse plans that no vehicle could drive.

    Args:
        plan: from the planner.
        xy_m: (2,) present position of the vehicle.
        model_step_s: spacing of replanning instants.
        owner: name of the planner, for messages.
        replan_every: number of these instants until the next plan, which this plan must cover.

    Raises:
        PlanRefusedError: wrong type or shape, NaN, a jump, or too short.
    """
    if not isinstance(plan, Controls | Trajectory):
        raise PlanRefusedError(f"{owner} returned a {type(plan).__name__}, not a Trajectory or Controls")
    problem = form_problem(plan, model_step_s, replan_every)
    if problem:
        raise PlanRefusedError(f"{owner} planned {type(plan).__name__} that cannot be driven: {problem}")
    problem = values_problem(plan)
    if problem:
        raise PlanRefusedError(f"{owner} planned {problem}")
    exact = in_float64(plan)
    if isinstance(exact, Trajectory):
        _check_jumps(exact, xy_m, owner)
    return exact


def check_joint_form(plan: JointPlan, owner: str) -> None:
    """Refuse a policy's plan whose vehicles lack a name, class or size, or whose time step is invalid.

    Args:
        plan: from the policy.
        owner: name for the message.

    Raises:
        PlanRefusedError: the plan has such a form.
    """
    _refuse(joint_form_problem(plan), owner)


def check_joint_plan(plan: JointPlan, xy_m: FloatArray, owner: str) -> BoolArray:
    """Refuse a policy's plan with NaN or a jump; return (A,) for which vehicles the first step is out of reach.

    Args:
        plan: from the policy.
        xy_m: (A, 2) present positions of its vehicles; NaN if absent.
        owner: name for the message.

    Raises:
        PlanRefusedError: NaN in a valid entry, or a jump within the plan.
    """
    _refuse(joint_values_problem(plan), owner)
    return starts_too_far(plan, xy_m)


def _refuse(problem: str, owner: str) -> None:
    """Raise PlanRefusedError if *problem* is not ""."""
    if problem:
        raise PlanRefusedError(f"{owner} planned {problem}")


def _check_jumps(plan: Trajectory, xy_m: FloatArray, owner: str) -> None:
    """Refuse a trajectory with a jump between two positions, or an impossible speed."""
    path = np.concatenate((xy_m[None], plan.xy_m))
    longest_m = float(np.linalg.norm(np.diff(path, axis=0), axis=-1).max())
    if longest_m > farthest_m(plan.dt_s):
        raise PlanRefusedError(f"{owner} planned a jump of {longest_m:.1f} m in {plan.dt_s:g} s")
    fastest_mps = float(np.abs(plan.speed_mps).max())
    if fastest_mps > MAX_SPEED_MPS:
        raise PlanRefusedError(
            f"{owner} planned a speed of {fastest_mps:g} m/s, beyond {MAX_SPEED_MPS:g} m/s"
        )
