"""Scenes that a planner meets sooner or later, made out of an ordinary one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import Scene, Tracks

_ASIDE_M = 15.0
_CLOSE_M = 8.0


def hard_scenes(scene: Scene) -> dict[str, Scene]:
    """Return variations of *scene* by what is hard about them.

    Args:
        scene: an ordinary instant with others around the target.
    """
    variants = {
        "nobody else is there": scene.without(np.ones(scene.history.agents, dtype=np.bool_)),
        "it stands": _standing(scene),
        "no route is known": replace(scene, routes=tuple(() for _ in scene.routes)),
        "nothing is known of the past": _without_past(scene),
        "it is off the road": _aside(scene),
    }
    blocked = _blocked(scene)
    return variants if blocked is None else {**variants, "somebody stands right before it": blocked}


def _standing(scene: Scene) -> Scene:
    """Return the scene with the target where it is, standing for as long as its past goes back."""
    history, row = scene.history, scene.target
    stopped = _stopped_at(history, row, history.xy_m[row, -1], float(history.yaw_rad[row, -1]))
    return replace(scene, history=stopped)


def _without_past(scene: Scene) -> Scene:
    steps = scene.history.steps
    return replace(scene, history=scene.history.where(np.arange(steps) == steps - 1))


def _aside(scene: Scene) -> Scene:
    history, row = scene.history, scene.target
    xy = history.xy_m.copy()
    xy[row] += _ASIDE_M * unit(np.asarray(history.yaw_rad[row, -1] + 0.5 * np.pi))
    return replace(scene, history=replace(history, xy_m=xy))


def _blocked(scene: Scene) -> Scene | None:
    """Return the scene with one of the others standing a few metres before the target; None without any."""
    history, row = scene.history, scene.target
    others = np.flatnonzero(history.valid[:, -1] & (np.arange(history.agents) != row))
    if not len(others):
        return None
    other = int(others[0])
    room = 0.5 * float(history.size_m[row, 0] + history.size_m[other, 0]) + _CLOSE_M
    place = history.xy_m[row, -1] + room * unit(np.asarray(history.yaw_rad[row, -1]))
    return replace(scene, history=_stopped_at(history, other, place, float(history.yaw_rad[row, -1])))


def _stopped_at(history: Tracks, row: int, place: np.ndarray, yaw_rad: float) -> Tracks:
    xy, yaw, speed = history.xy_m.copy(), history.yaw_rad.copy(), history.speed_mps.copy()
    there = history.valid[row]
    xy[row, there], yaw[row, there], speed[row, there] = place, yaw_rad, 0.0
    return replace(history, xy_m=xy, yaw_rad=yaw, speed_mps=speed)
