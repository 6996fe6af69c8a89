"""Contract checker of background policies, for every built-in and for users' own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.plan import MAX_SPEED_MPS, SLACK_M, JointPlan
from advdiff_sumo.core.scene import TRACK_ARRAYS, Scene, Tracks

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap
    from advdiff_sumo.traffic.policy_protocol import TrafficPolicy

_SEED = 20240501
_CLOCK_S = 1e-6


def check_policy(policy: TrafficPolicy, road: RoadMap, scene: Scene, log: Tracks | None) -> list[str]:
    """Return what *policy* does against its contract, one sentence each; empty when it keeps it.

    Plans twice from the same memory and random numbers, and once more half a second later on the clock.

    Args:
        policy: the policy.
        road: the map of the scene.
        scene: a first instant, with its background movable.
        log: what the vehicles did, or None.
    """
    for method in ("start", "plan"):
        if not callable(getattr(policy, method, None)):
            return [f"it has no method {method}"]
    scene_before, log_before = _prints(scene), _track_prints(log)
    try:
        memory = policy.start(road, scene, log, np.random.default_rng(_SEED))
        first = _plan(policy, road, scene, memory)
        again = _plan(policy, road, scene, memory)
        later_scene = replace(scene, history=scene.history.shifted(scene.history.dt_s))
        later = _plan(policy, road, later_scene, memory)
    except _BrokenContractError as error:
        return [str(error)]
    except Exception as error:  # noqa: BLE001 - a user's policy may raise anything; that is a finding
        return [f"it raised {type(error).__name__}: {error}"]
    return [
        *_plan_problems(first, scene),
        *(f"{problem} (planning {scene.history.dt_s} s later)" for problem in _clock(later, later_scene)),
        *_purity(first, again, scene_before == _prints(scene), log_before == _track_prints(log)),
    ]


class _BrokenContractError(Exception):
    """The plan is not of the form that anything else can be said about."""


def _plan(policy: TrafficPolicy, road: RoadMap, scene: Scene, memory: Any) -> JointPlan:
    returned: Any = policy.plan(road, scene, memory, np.random.default_rng(_SEED))
    if not (isinstance(returned, tuple) and len(returned) == 2):
        raise _BrokenContractError("plan must return (JointPlan, memory)")
    plan = returned[0]
    if not isinstance(plan, JointPlan) or not isinstance(plan.tracks, Tracks):
        raise _BrokenContractError(f"plan must return a JointPlan of Tracks first, not {type(plan).__name__}")
    return plan


def _plan_problems(plan: JointPlan, scene: Scene) -> Iterator[str]:
    yield from _clock(plan, scene)
    yield from _agents(plan.tracks, scene)
    yield from _values(plan.tracks)
    yield from _continuity(plan.tracks, scene)


def _clock(plan: JointPlan, scene: Scene) -> Iterator[str]:
    tracks, model_s = plan.tracks, scene.history.dt_s
    if not (np.isfinite(tracks.dt_s) and tracks.dt_s > 0.0):
        yield f"the plan's dt_s is {tracks.dt_s}; it must be positive"
        return
    expected = scene.time_s + tracks.dt_s
    if not abs(tracks.t0_s - expected) <= _CLOCK_S:
        yield f"the plan starts at t0_s = {tracks.t0_s:g}, expected now + dt_s = {expected:g}"
    if tracks.agents and tracks.steps * tracks.dt_s < model_s - _CLOCK_S:
        yield f"the plan lasts {tracks.steps * tracks.dt_s:g} s, less than one model step of {model_s:g} s"


def _agents(tracks: Tracks, scene: Scene) -> Iterator[str]:
    history = scene.history
    for row, name in enumerate(tracks.ids):
        at = history.index.get(name)
        if at is None:
            continue
        if name == scene.target_id:
            yield f"it plans for the target '{name}'"
        elif not scene.movable[at]:
            yield f"it plans for '{name}', which is not movable"
        if tracks.classes[row] != history.classes[at]:
            yield f"it changes the class of '{name}'"
        if not np.allclose(tracks.size_m[row], history.size_m[at], atol=1e-6):
            yield f"it changes the size of '{name}' from {history.size_m[at]} to {tracks.size_m[row]}"


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


def _continuity(tracks: Tracks, scene: Scene) -> Iterator[str]:
    bound = MAX_SPEED_MPS * tracks.dt_s + SLACK_M
    for row, name in enumerate(tracks.ids):
        at = scene.history.index.get(name)
        path = tracks.xy_m[row]
        if at is not None and scene.history.valid[at, -1]:
            path = np.vstack((scene.history.xy_m[at, -1:], path))
        jumps = np.linalg.norm(np.diff(path, axis=0), axis=-1)
        if (jumps > bound).any():
            yield (
                f"'{name}' jumps {np.nanmax(jumps):.1f} m in {tracks.dt_s:g} s, beyond {MAX_SPEED_MPS:g} m/s"
            )


def _purity(first: JointPlan, again: JointPlan, scene_kept: bool, log_kept: bool) -> Iterator[str]:
    if not scene_kept:
        yield "it changes the scene that it was given"
    if not log_kept:
        yield "it changes the log that it was given"
    if _track_prints(first.tracks) != _track_prints(again.tracks) or first.exact != again.exact:
        yield (
            "two plans from the same memory and random numbers differ: "
            "draw from rng only, and return new memory instead of changing the old"
        )


def _prints(scene: Scene) -> tuple[object, ...]:
    flags = scene.movable.tobytes()
    return (*_track_prints(scene.history), scene.target, flags, scene.routes, dict(scene.signals))


def _track_prints(tracks: Tracks | None) -> tuple[object, ...]:
    if tracks is None:
        return ()
    arrays = (np.asarray(getattr(tracks, name)).tobytes() for name in TRACK_ARRAYS)
    return (tracks.ids, tracks.t0_s, tracks.dt_s, *arrays)
