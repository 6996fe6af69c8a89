"""Checks whether a background policy, built-in or a user's own, keeps the rules of policies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, stretches
from advdiff_sumo.core.contract import (
    Problem,
    content_of,
    only_added_to,
    remembers_situations,
    what_it_raised,
)
from advdiff_sumo.core.joint_plan_form import farthest_m, joint_form_problem, joint_values_problem
from advdiff_sumo.core.plan import MAX_SPEED_MPS, JointPlan
from advdiff_sumo.core.plan_form import interval_problem
from advdiff_sumo.core.plan_motion import motion_faults
from advdiff_sumo.core.scene import Scene, Tracks

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap
    from advdiff_sumo.traffic.policy_protocol import TrafficPolicy

_SEED = 20240501
_CLOCK_S = 1e-6
"""Times that differ by no more than this are the same."""
_COPY_REMEDY = "copy what you change, as by scene.copied() or log.copied()"
_VEHICLES_REMEDY = "plan for those of scene.movable, with the classes and sizes of scene.history"
_MOTION_REMEDY = "begin where scene.history ends, and let place, heading and speed agree"


class PolicyPart(StrEnum):
    """Parts of the contract of a policy, in the order in which they are checked."""

    METHODS = "methods"
    RAISES = "raises nothing"
    FORM = "form"
    VEHICLES = "moves whom it may"
    NUMBERS = "numbers"
    MOTION = "motion"
    REPEATS = "repeats itself"
    GIVEN = "inputs left alone"


def check_policy(policy: TrafficPolicy, road: RoadMap, scene: Scene, log: Tracks | None) -> list[str]:
    """Return how *policy* breaks its contract, one sentence each; empty if it keeps it.

    The policy plans twice from the same memory and random numbers, and a third time half a second later on the
    clock, each time in a copy of *scene*, as in an episode.

    Args:
        policy: the policy.
        road: the map of the scene.
        scene: a first instant, with its background movable.
        log: tracks of the vehicles in reality or natural traffic, or None.
    """
    return [problem.text for problem in policy_problems(policy, road, scene, log) if not problem.harmless]


def policy_problems(policy: TrafficPolicy, road: RoadMap, scene: Scene, log: Tracks | None) -> list[Problem]:
    """Return the findings of :func:`check_policy`, each with the part of the contract that is broken."""
    for method in ("start", "plan"):
        if not callable(getattr(policy, method, None)):
            return [Problem(PolicyPart.METHODS, f"it has no method {method}")]
    before, scenes = (content_of(scene), content_of(log)), [scene.copied() for _ in range(4)]
    later_scene = replace(scene, history=scene.history.shifted(scene.history.dt_s))
    try:
        memory = policy.start(road, scenes[0], log, np.random.default_rng(_SEED))
        started = content_of(memory, (road,))
        restarted = content_of(policy.start(road, scenes[1], log, np.random.default_rng(_SEED)), (road,))
        plans = [_plan(policy, road, now, memory) for now in (*scenes[2:], later_scene.copied())]
    except _BrokenContractError as error:
        return [Problem(PolicyPart.FORM, str(error))]
    except BaseException as error:  # noqa: BLE001 - a user's policy may raise anything; that is a finding
        return [Problem(PolicyPart.RAISES, what_it_raised(error, policy))]
    later = (
        f"{problem} (planning {scene.history.dt_s} s later)" for problem in _clock(plans[2], later_scene)
    )
    problems = [*_plan_problems(plans[0], scene, log), *(Problem(PolicyPart.FORM, text) for text in later)]
    if any(problem.part is PolicyPart.FORM for problem in problems):
        return problems
    problems += _repeats(only_added_to(started, restarted), content_of(plans[0]) == content_of(plans[1]))
    changed = next((content for content in map(content_of, scenes) if content != before[0]), before[0])
    return [*problems, *_changes((*before, started), (changed, content_of(log), content_of(memory, (road,))))]


def plans_from_memory_of_others(
    policy: TrafficPolicy, road: RoadMap, situations: Sequence[tuple[Scene, Tracks | None]]
) -> bool:
    """Return whether the first plan in the first scene changes after *policy* has planned in all of them.

    Args:
        policy: the policy.
        road: the map of the scenes.
        situations: at least one scene, each with its log; they are not changed.
    """

    def first_plan(situation: tuple[Scene, Tracks | None]) -> object:
        scene, log = situation[0].copied(), situation[1] and situation[1].copied()
        memory = policy.start(road, scene, log, np.random.default_rng(_SEED))
        return content_of(_plan(policy, road, scene, memory))

    return remembers_situations(first_plan, situations, lambda first, other: first == other)


class _BrokenContractError(Exception):
    """The form of the plan is so wrong that nothing else can be checked."""


def _plan(policy: TrafficPolicy, road: RoadMap, scene: Scene, memory: Any) -> JointPlan:
    """Return a copy of the policy's plan, as the policy may reuse its arrays for the next plan."""
    returned: Any = policy.plan(road, scene, memory, np.random.default_rng(_SEED))
    if not (isinstance(returned, tuple) and len(returned) == 2):
        raise _BrokenContractError("plan must return (JointPlan, memory)")
    plan = returned[0]
    if not isinstance(plan, JointPlan) or not isinstance(plan.tracks, Tracks):
        raise _BrokenContractError(f"plan must return a JointPlan of Tracks first, not {type(plan).__name__}")
    return replace(plan, tracks=plan.tracks.copied())


def _plan_problems(plan: JointPlan, scene: Scene, log: Tracks | None) -> list[Problem]:
    """Return the problems of *plan* by part; without any, the reason for which a run would refuse it, if it would."""
    form = [Problem(PolicyPart.FORM, text) for text in (*_clock(plan, scene), *_arrays(plan.tracks))]
    if form:
        return form
    problems = [
        Problem(PolicyPart.VEHICLES, text, remedy=_VEHICLES_REMEDY) for text in _agents(plan, scene, log)
    ]
    numbers = [Problem(PolicyPart.NUMBERS, text) for text in _values(plan.tracks)]
    motion = () if numbers else _motion(plan, scene)
    problems += [*numbers, *(Problem(PolicyPart.MOTION, text, remedy=_MOTION_REMEDY) for text in motion)]
    refused = "" if problems else joint_form_problem(plan) or joint_values_problem(plan)
    return [Problem(PolicyPart.FORM, f"a run refuses its plan: {refused}")] if refused else problems


def _clock(plan: JointPlan, scene: Scene) -> Iterator[str]:
    tracks, model_s = plan.tracks, scene.history.dt_s
    interval = interval_problem(tracks.dt_s)
    if interval:
        yield f"the plan's dt_s {interval}"
        return
    t0_s: Any = tracks.t0_s
    if not isinstance(t0_s, int | float | np.number):
        yield f"the plan's t0_s is of type {type(t0_s).__name__}, not a number of seconds"
        return
    expected = scene.time_s + tracks.dt_s
    if not abs(tracks.t0_s - expected) <= _CLOCK_S:
        yield f"the plan starts at t0_s = {tracks.t0_s:g}, expected now + dt_s = {expected:g}"
    if tracks.agents and tracks.steps * tracks.dt_s < model_s - _CLOCK_S:
        yield f"the plan lasts {tracks.steps * tracks.dt_s:g} s, less than one model step of {model_s:g} s"


def _arrays(tracks: Tracks) -> Iterator[str]:
    for name in ("classes", "size_m", "xy_m", "yaw_rad", "speed_mps"):
        dtype = getattr(tracks, name).dtype
        if dtype.kind not in "fiu":
            yield f"{name} holds {dtype}, not numbers"


def _agents(plan: JointPlan, scene: Scene, log: Tracks | None) -> Iterator[str]:
    tracks, history = plan.tracks, scene.history
    for row, name in enumerate(tracks.ids):
        scene_row = history.index.get(name)
        if scene_row is None:
            if log is not None and name in log.index and not plan.exact:
                yield f"it lets in '{name}', whom the scene's log has: give who comes in another id"
            continue
        if name == scene.target_id:
            yield f"it plans for the target '{name}'"
        elif not scene.movable[scene_row]:
            yield f"it plans for '{name}', which is not movable"
        if tracks.classes[row] != history.classes[scene_row]:
            yield f"it changes the class of '{name}'"
        if not np.allclose(tracks.size_m[row], history.size_m[scene_row], atol=1e-6):
            yield f"it changes the size of '{name}' from {history.size_m[scene_row]} to {tracks.size_m[row]}"


def _values(tracks: Tracks) -> Iterator[str]:
    if not (np.isfinite(tracks.size_m) & (tracks.size_m > 0.0)).all():
        yield "size_m holds a value that is no positive length"
    for name in ("xy_m", "yaw_rad", "speed_mps"):
        values: FloatArray = getattr(tracks, name)
        finite: BoolArray = np.isfinite(values)
        if finite.ndim == 3:
            finite = np.asarray(finite.all(-1))
        bad = np.argwhere(tracks.valid & ~finite)
        if len(bad):
            row, step = bad[0]
            yield f"{name} of '{tracks.ids[row]}' is not finite at step {step}, where valid is True"
        if (~tracks.valid & finite).any():
            yield f"{name} holds numbers where valid is False; it must hold NaN there"
        if values.dtype != np.float64:
            yield f"{name} is {values.dtype}; it must be float64"
    if tracks.valid.dtype != np.bool_:
        yield f"valid is {tracks.valid.dtype}; it must be bool"


def _motion(plan: JointPlan, scene: Scene) -> Iterator[str]:
    """Yield jumps, and motion up to the next plan that the bicycle model cannot drive."""
    tracks, farthest = plan.tracks, farthest_m(plan.tracks.dt_s)
    driven = 1 + int(np.ceil(scene.history.dt_s / tracks.dt_s - _CLOCK_S))
    for row, name in enumerate(tracks.ids):
        xy, yaw, speed, valid = _from_now(tracks, row, scene)
        jumps = np.linalg.norm(np.diff(xy, axis=0), axis=-1)
        if (jumps > farthest).any():
            yield (
                f"'{name}' jumps {np.nanmax(jumps):.1f} m in {tracks.dt_s:g} s, beyond {MAX_SPEED_MPS:g} m/s"
            )
        elif not plan.exact:
            for start, stop in stretches(valid[:driven])[:1]:
                faults = motion_faults(xy[start:stop], yaw[start:stop], speed[start:stop], tracks.dt_s, start)
                yield from (f"'{name}': {fault}" for fault in faults)


def _from_now(tracks: Tracks, row: int, scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return the states of a planned vehicle and when they are valid, (T + 1, …), from its state in the scene on."""
    now = scene.history.window(scene.history.steps - 1, scene.history.steps)
    now_row = now.index.get(tracks.ids[row])
    if now_row is None or not now.valid[now_row, -1]:
        xy, yaw, speed, valid = np.full((1, 2), np.nan), [np.nan], [np.nan], [False]
    else:
        xy, yaw, speed, valid = now.xy_m[now_row], now.yaw_rad[now_row], now.speed_mps[now_row], [True]
    return (
        np.concatenate((xy, tracks.xy_m[row])),
        np.append(yaw, tracks.yaw_rad[row]),
        np.append(speed, tracks.speed_mps[row]),
        np.append(valid, tracks.valid[row]),
    )


def _repeats(starts_same: bool, plans_same: bool) -> Iterator[Problem]:
    if not starts_same:
        text = (
            "start returns two different memories for the same scene and random numbers: draw from rng only"
        )
        yield Problem(PolicyPart.REPEATS, text)
    if not plans_same:
        text = (
            "two plans from the same memory and random numbers differ: "
            "draw from rng only, and return new memory instead of changing the old"
        )
        yield Problem(PolicyPart.REPEATS, text)


def _changes(before: tuple[object, ...], after: tuple[object, ...]) -> Iterator[Problem]:
    """Yield which of scene, log and memory were changed; additions to tables in the memory may be caches."""
    remedies = {"scene": _COPY_REMEDY, "log": _COPY_REMEDY, "memory": "return new memory instead"}
    for (what, remedy), old, new in zip(remedies.items(), before, after, strict=True):
        if old != new:
            cache = what == "memory" and only_added_to(old, new)
            text = (
                "it adds to tables in its memory, as a cache may"
                if cache
                else f"it changes the {what} that it was given"
            )
            yield Problem(PolicyPart.GIVEN, text, cache, "" if cache else remedy)
