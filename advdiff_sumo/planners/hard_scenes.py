"""Make difficult scenes out of an ordinary one, to check planners and background policies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import TRACK_ARRAYS, Scene, Tracks

_OFF_ROAD_M = 15.0  # to the left of the present position
_GAP_M = 8.0  # bumper to bumper
_CROWD = 120  # road users


def hard_scenes(scene: Scene, who: str = "it") -> dict[str, Scene]:
    """Return variations of *scene*; each key says what is difficult.

    Args:
        scene: an ordinary instant with others around the target.
        who: name of the target in the keys.
    """
    variants = {
        "nobody else is there": scene.without(np.ones(scene.history.agents, dtype=np.bool_)),
        f"{who} stands": _standing(scene),
        "no route is known": replace(scene, routes=tuple(() for _ in scene.routes)),
        "nothing is known of the past": _without_past(scene),
        f"{who} is off the road": _off_road(scene),
    }
    blocked = _blocked(scene)
    return variants if blocked is None else {**variants, f"somebody stands right before {who}": blocked}


def hard_scenes_of_traffic(scene: Scene) -> dict[str, Scene]:
    """Return the same variations for background policies, and two more: nobody movable, and a crowd."""
    crowd = _crowded(scene)
    many = {} if crowd is None else {f"{_CROWD} road users are there": crowd}
    nobody = replace(scene, movable=np.zeros(scene.history.agents, dtype=np.bool_))
    return hard_scenes(scene, "the target") | {"nobody may be moved": nobody} | many


def _crowded(scene: Scene) -> Scene | None:
    """Return the scene with copies of the others in lines behind them; None without others."""
    history = scene.history
    others = np.flatnonzero(history.valid[:, -1] & (np.arange(history.agents) != scene.target))
    if not len(others):
        return None
    rows = np.resize(others, max(_CROWD - history.agents, 0))
    copy_number = 1 + np.arange(len(rows)) // len(others)
    behind_m = copy_number * (history.size_m[rows, 0] + _GAP_M)
    offset = behind_m[:, None, None] * unit(history.yaw_rad[rows])
    arrays = {name: getattr(history, name)[rows] for name in TRACK_ARRAYS}
    copies = Tracks(
        ids=tuple(
            f"{history.ids[row]} again {k}"
            for row, k in zip(rows.tolist(), copy_number.tolist(), strict=True)
        ),
        t0_s=history.t0_s,
        dt_s=history.dt_s,
        **{**arrays, "xy_m": arrays["xy_m"] - offset},
    )
    return replace(
        scene,
        history=history.joined(copies),
        movable=np.concatenate((scene.movable, scene.movable[rows])),
        routes=(*scene.routes, *(scene.routes[row] for row in rows.tolist())),
    )


def _standing(scene: Scene) -> Scene:
    """Return the scene with the target standing at its present place during the whole history."""
    history, row = scene.history, scene.target
    stopped = _stopped_at(history, row, history.xy_m[row, -1], float(history.yaw_rad[row, -1]))
    return replace(scene, history=stopped)


def _without_past(scene: Scene) -> Scene:
    """Return the scene with the last instant as its only valid one."""
    steps = scene.history.steps
    return replace(scene, history=scene.history.where(np.arange(steps) == steps - 1))


def _off_road(scene: Scene) -> Scene:
    """Return the scene with the target beside the road."""
    history, row = scene.history, scene.target
    xy = history.xy_m.copy()
    xy[row] += _OFF_ROAD_M * unit(np.asarray(history.yaw_rad[row, -1] + 0.5 * np.pi))
    return replace(scene, history=replace(history, xy_m=xy))


def _blocked(scene: Scene) -> Scene | None:
    """Return the scene with one of the others standing shortly before the target; None without others."""
    history, row = scene.history, scene.target
    others = np.flatnonzero(history.valid[:, -1] & (np.arange(history.agents) != row))
    if not len(others):
        return None
    other = int(others[0])
    distance_m = 0.5 * float(history.size_m[row, 0] + history.size_m[other, 0]) + _GAP_M
    xy_m = history.xy_m[row, -1] + distance_m * unit(np.asarray(history.yaw_rad[row, -1]))
    return replace(scene, history=_stopped_at(history, other, xy_m, float(history.yaw_rad[row, -1])))


def _stopped_at(history: Tracks, row: int, xy_m: np.ndarray, yaw_rad: float) -> Tracks:
    """Return *history* with agent *row* standing at *xy_m* (2,) throughout."""
    xy, yaw, speed = history.xy_m.copy(), history.yaw_rad.copy(), history.speed_mps.copy()
    is_valid = history.valid[row]
    xy[row, is_valid], yaw[row, is_valid], speed[row, is_valid] = xy_m, yaw_rad, 0.0
    return replace(history, xy_m=xy, yaw_rad=yaw, speed_mps=speed)
