"""Check the form and the values of a policy's plan: names, classes, sizes, interval, numbers, and no jumps."""

from __future__ import annotations

from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.plan import MAX_SPEED_MPS, SLACK_M, JointPlan
from advdiff_sumo.core.plan_form import interval_problem
from advdiff_sumo.core.scene import AgentClass, Tracks


def joint_form_problem(plan: JointPlan) -> str:
    """Return the problem with the form of *plan*, as the object of "it planned"; "" if there is none."""
    tracks: Any = plan.tracks
    if not isinstance(tracks, Tracks):
        return f"tracks of type {type(tracks).__name__}, not Tracks"
    problem = interval_problem(tracks.dt_s)
    if problem:
        return f"tracks whose dt_s {problem}"
    ids: tuple[Any, ...] = tracks.ids
    if not all(isinstance(name, str) and name for name in ids):
        return f"for a vehicle whose name is no text: {tracks.ids!r}"
    wrong = ~np.isin(tracks.classes, [int(agent_class) for agent_class in AgentClass])
    wrong |= ~(np.isfinite(tracks.size_m) & (tracks.size_m > 0.0)).all(axis=1)
    return _first(wrong[:, None], tracks.ids, "a class that is none, or a size that is not positive,")


def joint_values_problem(plan: JointPlan) -> str:
    """Return the problem with the values of *plan*, whose form is valid: not a number, a jump, or too fast."""
    tracks = plan.tracks
    finite = np.isfinite(tracks.xy_m).all(-1) & np.isfinite(tracks.yaw_rad) & np.isfinite(tracks.speed_mps)
    if (tracks.valid & ~finite).any():
        return _first(tracks.valid & ~finite, tracks.ids, "a value that is not a number")
    valid_steps = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    bound = farthest_m(tracks.dt_s)
    jumps = valid_steps & (np.linalg.norm(np.diff(tracks.xy_m, axis=1), axis=-1) > bound)
    too_fast = tracks.valid & (np.abs(tracks.speed_mps) > MAX_SPEED_MPS)
    jump = _first(jumps, tracks.ids, f"a jump of more than {bound:.1f} m in {tracks.dt_s:g} s")
    return jump or _first(too_fast, tracks.ids, f"a speed beyond {MAX_SPEED_MPS:g} m/s")


def starts_too_far(plan: JointPlan, xy_m: FloatArray) -> BoolArray:
    """Return (A,) whether the first step from *xy_m* (A, 2) is a jump; *xy_m* is NaN for vehicles not yet present."""
    tracks = plan.tracks
    move = np.linalg.norm(tracks.xy_m[:, 0] - xy_m, axis=-1) if tracks.steps else np.zeros(tracks.agents)
    return np.asarray(move > farthest_m(tracks.dt_s))  # NaN compares as False


def farthest_m(dt_s: float) -> float:
    """Return the greatest distance that a vehicle may move in *dt_s*."""
    return MAX_SPEED_MPS * dt_s + SLACK_M


def _first(wrong: BoolArray, ids: tuple[str, ...], what: str) -> str:
    """Return *what* with the first vehicle and step of *wrong* (A, T); "" if none is True."""
    if not wrong.any():
        return ""
    row, step = np.argwhere(wrong)[0]
    return f"{what} for vehicle '{ids[row]}' at step {step}"
