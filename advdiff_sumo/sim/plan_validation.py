"""Plans are checked before SUMO sees them: SUMO itself accepts NaN and any jump without a word."""

from __future__ import annotations

from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.errors import PlanRefusedError
from advdiff_sumo.core.plan import MAX_SPEED_MPS, SLACK_M, Controls, JointPlan, Plan, Trajectory
from advdiff_sumo.core.plan_form import form_problem, in_float64, interval_problem, values_problem
from advdiff_sumo.core.scene import AgentClass, Tracks


def check_plan(plan: Plan, xy_m: FloatArray, model_step_s: float, who: str, replan_every: int = 1) -> Plan:
    """Return a planner's plan in float64; one that no vehicle could drive is refused.

    Args:
        plan: from the planner.
        xy_m: (2,) where the vehicle is now.
        model_step_s: spacing of replanning instants.
        who: name for the message.
        replan_every: of these instants to the next plan, to which this one must last.

    Raises:
        PlanRefusedError: of another type or shape, NaN, a jump, or too short.
    """
    if not isinstance(plan, Controls | Trajectory):
        raise PlanRefusedError(f"{who} returned a {type(plan).__name__}, not a Trajectory or Controls")
    problem = form_problem(plan, model_step_s, replan_every)
    if problem:
        raise PlanRefusedError(f"{who} planned {type(plan).__name__} that cannot be driven: {problem}")
    problem = values_problem(plan)
    if problem:
        raise PlanRefusedError(f"{who} planned {problem}")
    exact = in_float64(plan)
    if isinstance(exact, Trajectory):
        _check_jumps(exact, xy_m, who)
    return exact


def check_joint_form(plan: JointPlan, who: str) -> None:
    """Refuse a policy's plan whose vehicles have no name, class or size, or whose interval is no time.

    Args:
        plan: from the policy.
        who: name for the message.

    Raises:
        PlanRefusedError: so.
    """
    tracks = plan.tracks
    if not isinstance(tracks, Tracks):
        raise PlanRefusedError(f"{who} planned tracks of type {type(tracks).__name__}, not Tracks")
    problem = interval_problem(tracks.dt_s)
    if problem:
        raise PlanRefusedError(f"{who} planned tracks whose dt_s {problem}")
    ids: tuple[Any, ...] = tracks.ids
    if not all(isinstance(name, str) and name for name in ids):
        raise PlanRefusedError(f"{who} planned for a vehicle whose name is no text: {tracks.ids!r}")
    wrong = ~np.isin(tracks.classes, [int(agent_class) for agent_class in AgentClass])
    wrong |= ~(np.isfinite(tracks.size_m) & (tracks.size_m > 0.0)).all(axis=1)
    _refuse(wrong[:, None], tracks.ids, who, "a class that is none, or a size that is not positive,")


def check_joint_plan(plan: JointPlan, xy_m: FloatArray, who: str) -> BoolArray:
    """Refuse a policy's plan that holds NaN or a jump; returns (A,) whose first step is out of reach.

    Args:
        plan: from the policy.
        xy_m: (A, 2) where its vehicles are now; NaN for those not there yet.
        who: name for the message.

    Raises:
        PlanRefusedError: NaN in a valid entry, or a jump within the plan.
    """
    tracks = plan.tracks
    finite = np.isfinite(tracks.xy_m).all(-1) & np.isfinite(tracks.yaw_rad) & np.isfinite(tracks.speed_mps)
    _refuse(tracks.valid & ~finite, tracks.ids, who, "a value that is not a number")
    both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    stride = np.linalg.norm(np.diff(tracks.xy_m, axis=1), axis=-1)
    bound = MAX_SPEED_MPS * tracks.dt_s + SLACK_M
    _refuse(
        both & (stride > bound), tracks.ids, who, f"a jump of more than {bound:.1f} m in {tracks.dt_s:g} s"
    )
    too_fast = tracks.valid & (np.abs(tracks.speed_mps) > MAX_SPEED_MPS)
    _refuse(too_fast, tracks.ids, who, f"a speed beyond {MAX_SPEED_MPS:g} m/s")
    first = np.linalg.norm(tracks.xy_m[:, 0] - xy_m, axis=-1) if tracks.steps else np.zeros(tracks.agents)
    return np.asarray(first > bound)  # NaN compares as False


def _refuse(wrong: BoolArray, ids: tuple[str, ...], who: str, what: str) -> None:
    if wrong.any():
        row, step = np.argwhere(wrong)[0]
        raise PlanRefusedError(f"{who} planned {what} for vehicle '{ids[row]}' at step {step}")


def _check_jumps(plan: Trajectory, xy_m: FloatArray, who: str) -> None:
    path = np.concatenate((xy_m[None], plan.xy_m))
    jump = float(np.linalg.norm(np.diff(path, axis=0), axis=-1).max())
    if jump > MAX_SPEED_MPS * plan.dt_s + SLACK_M:
        raise PlanRefusedError(f"{who} planned a jump of {jump:.1f} m in {plan.dt_s:g} s")
    fastest = float(np.abs(plan.speed_mps).max())
    if fastest > MAX_SPEED_MPS:
        raise PlanRefusedError(f"{who} planned a speed of {fastest:.0f} m/s, beyond {MAX_SPEED_MPS:g} m/s")
