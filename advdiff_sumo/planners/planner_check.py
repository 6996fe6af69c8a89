"""Check that a planner, built-in or a user's, keeps the contract of planners."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.contract import Problem, content_of, remembers_situations, what_it_raised
from advdiff_sumo.core.errors import EpisodeFailure, PlanRefusedError
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.plan_form import form_problem, in_float64, plan_arrays
from advdiff_sumo.core.plan_motion import SLACK_MPS, motion_faults
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_protocol import Planner

_SEED = 20080915


class Part(StrEnum):
    """Parts of the contract, in the order in which they are checked."""

    METHODS = "methods"
    RAISES = "raises nothing"
    FORM = "form"
    NUMBERS = "numbers"
    MOTION = "motion"
    REPEATS = "repeats itself"
    SCENE = "scene left alone"


def check_planner(planner: Planner, road: RoadMap, scene: Scene) -> list[str]:
    """Return the breaches of the contract by *planner*, one sentence each; empty if there are none.

    The planner plans twice from equal memories and random numbers, then once more from the memory that its first
    plan returned. Each time it gets a copy of *scene*, as in an episode. The duration of plans is not part of the
    contract; see :func:`planning_times_s`.

    Args:
        planner: the planner.
        road: the map of the scene.
        scene: the first instant of an episode.
    """
    return [problem.text for problem in problems_of(planner, road, scene) if not problem.harmless]


def problems_of(planner: Planner, road: RoadMap, scene: Scene) -> list[Problem]:
    """Return the findings of :func:`check_planner`, and harmless ones, each with the part of the contract."""
    missing = [method for method in ("start", "plan") if not callable(getattr(planner, method, None))]
    if missing:
        return [Problem(Part.METHODS, f"it has no method {method}") for method in missing]
    try:
        first, memory = _first_plan(planner, road, scene)
        again, _ = _first_plan(planner, road, scene)
        passed_scene = scene.copied()
        second, _ = _unpacked(planner.plan(road, passed_scene, memory, np.random.default_rng(_SEED)))
    except _BrokenContractError as error:
        return [Problem(Part.FORM, str(error))]
    except EpisodeFailure as error:  # of a remote planner; its message explains the fault
        part = Part.FORM if isinstance(error, PlanRefusedError) else Part.RAISES
        return [Problem(part, str(error))]
    except BaseException as error:  # noqa: BLE001 - a user's planner may raise anything; that is a finding
        return [Problem(Part.RAISES, what_it_raised(error, planner))]
    problems = _plan_problems(first, scene)
    problems += [Problem(x.part, f"{x.text} (in its second plan)") for x in _plan_problems(second, scene)]
    if any(x.part is Part.FORM for x in problems):
        return problems
    if not same_plan(first, again):
        text = (
            "the same scene, memory and random numbers gave two different plans; "
            "keep state in the memory and draw from the generator that is passed in"
        )
        problems.append(Problem(Part.REPEATS, text))
    if content_of(passed_scene) != content_of(scene):
        text = "it writes into the scene, which it may: it is given a copy of its own"
        problems.append(Problem(Part.SCENE, text, harmless=True))
    return problems


def carries_over(planner: Planner, road: RoadMap, scenes: Sequence[Scene]) -> bool:
    """Return whether the first plan in the first scene changes after *planner* has planned in all scenes.

    False for a planner that raises, which other checks find.
    """
    return remembers_situations(lambda scene: _first_plan(planner, road, scene)[0], scenes, same_plan)


def planning_times_s(planner: Planner, road: RoadMap, scene: Scene, plans: int = 20) -> FloatArray:
    """Return the wall-clock seconds (plans,) of consecutive plans in *scene*; the first may fill caches."""
    rng = np.random.default_rng(_SEED)
    memory = planner.start(road, scene.copied(), rng)
    durations = np.empty(plans)
    for k in range(plans):
        passed_scene = scene.copied()
        start_s = time.perf_counter()
        _, memory = planner.plan(road, passed_scene, memory, rng)
        durations[k] = time.perf_counter() - start_s
    return durations


class _BrokenContractError(Exception):
    """The planner returned something that is no plan, so that nothing else can be checked."""


def _first_plan(planner: Planner, road: RoadMap, scene: Scene) -> tuple[Plan, Any]:
    """Return the first plan of an episode and the memory after it."""
    memory = planner.start(road, scene.copied(), np.random.default_rng(_SEED))
    return _unpacked(planner.plan(road, scene.copied(), memory, np.random.default_rng(_SEED)))


def _unpacked(answer: object) -> tuple[Plan, Any]:
    """Return plan and memory out of what a planner returned; the plan's arrays are copied."""
    if not (isinstance(answer, tuple) and len(answer) == 2):
        raise _BrokenContractError(f"plan() returned {type(answer).__name__}, not (plan, memory)")
    if not isinstance(answer[0], Trajectory | Controls):
        raise _BrokenContractError(
            f"plan() returned a {type(answer[0]).__name__}, not a Trajectory or Controls"
        )
    plan, memory = answer
    arrays = {name: getattr(plan, name) for name in plan_arrays(plan)}
    copies = {name: array.copy() for name, array in arrays.items() if isinstance(array, np.ndarray)}
    return replace(plan, **copies), memory  # the planner may write its next plan into the same arrays


def _plan_problems(plan: Plan, scene: Scene) -> list[Problem]:
    """Return the breaches of the contract by one plan."""
    problem = form_problem(plan, scene.history.dt_s)
    if problem:
        return [Problem(Part.FORM, problem)]
    exact = in_float64(plan)
    for name in plan_arrays(exact):
        if not np.isfinite(getattr(exact, name)).all():
            return [Problem(Part.NUMBERS, f"{name} holds values that are not finite")]
    return [Problem(Part.MOTION, text) for text in motion_problems(exact, scene)]


def motion_problems(plan: Plan, scene: Scene) -> list[str]:
    """Return what *plan*, with 64-bit numbers, demands of the target in *scene* that no vehicle can do."""
    return _control_problems(plan) if isinstance(plan, Controls) else _trajectory_problems(plan, scene)


def _control_problems(plan: Controls) -> list[str]:
    limits, problems = Limits(), []
    if plan.accel_mps2.max() > limits.accel_mps2 + SLACK_MPS:
        problems.append(f"it accelerates by {plan.accel_mps2.max():.1f} m/s², over {limits.accel_mps2:g}")
    if plan.accel_mps2.min() < -limits.brake_mps2 - SLACK_MPS:
        problems.append(f"it brakes by {-plan.accel_mps2.min():.1f} m/s², over {limits.brake_mps2:g}")
    if np.abs(plan.steer_rad).max() > limits.steer_rad + 1e-6:
        problems.append(f"it steers by {np.abs(plan.steer_rad).max():.2f} rad, over {limits.steer_rad:g}")
    return problems


def _trajectory_problems(plan: Trajectory, scene: Scene) -> list[str]:
    """Check that a vehicle can drive each step, the one from the present state included."""
    row, history = scene.target, scene.history
    xy = np.concatenate((history.xy_m[row, -1:], plan.xy_m))
    yaw = np.append(history.yaw_rad[row, -1], plan.yaw_rad)
    speed = np.append(history.speed_mps[row, -1], plan.speed_mps)
    return motion_faults(xy, yaw, speed, plan.dt_s)


def same_plan(first: Plan, second: Plan) -> bool:
    """Return whether two plans are equal to the bit."""
    if type(first) is not type(second):
        return False
    pairs = ((getattr(first, name), getattr(second, name)) for name in plan_arrays(first))
    equal = all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
    return equal and first.dt_s == second.dt_s
