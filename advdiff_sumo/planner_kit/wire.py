"""Scenes and plans as messages, and back to the same bits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.plan_form import form_problem, in_float64, plan_arrays
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.planner_kit import messages


def scene_message(scene: Scene, osi_ground_truth: bytes = b"") -> Any:
    """Return what a planner may know of *scene*; the others' routes and who is moved are left out."""
    history = scene.history
    objects = [_object(history, row) for row in range(history.agents)]
    return messages.Scene(
        first_time_s=history.t0_s,
        step_s=history.dt_s,
        own=objects.pop(scene.target),
        others=objects,
        route=scene.routes[scene.target],
        signals=scene.signals,
        osi_ground_truth=osi_ground_truth,
        own_index=scene.target,
    )


def _object(tracks: Tracks, row: int) -> Any:
    x, y = tracks.xy_m[row].T.tolist()
    length, width = tracks.size_m[row].tolist()
    return messages.Object(
        id=tracks.ids[row],
        object_class=int(tracks.classes[row]),
        length_m=length,
        width_m=width,
        x_m=x,
        y_m=y,
        yaw_rad=tracks.yaw_rad[row].tolist(),
        speed_mps=tracks.speed_mps[row].tolist(),
    )


def scene_of(message: Any) -> Scene:
    """Return the scene in *message*; nobody in it is movable, and of the routes only the own one is known."""
    objects = list(message.others)
    objects.insert(message.own_index, message.own)
    yaw = np.array([o.yaw_rad for o in objects], dtype=np.float64)
    tracks = Tracks(
        ids=tuple(o.id for o in objects),
        classes=np.array([o.object_class for o in objects], dtype=np.int64),
        size_m=np.array([(o.length_m, o.width_m) for o in objects], dtype=np.float64),
        xy_m=np.stack((_rows(objects, "x_m"), _rows(objects, "y_m")), axis=-1),
        yaw_rad=yaw,
        speed_mps=_rows(objects, "speed_mps"),
        valid=np.isfinite(yaw),
        t0_s=message.first_time_s,
        dt_s=message.step_s,
    )
    routes: list[tuple[str, ...]] = [()] * tracks.agents
    routes[message.own_index] = tuple(message.route)
    movable = np.zeros(tracks.agents, dtype=np.bool_)
    return Scene(tracks, message.own_index, movable, tuple(routes), dict(message.signals))


def _rows(objects: list[Any], name: str) -> FloatArray:
    return np.array([getattr(o, name) for o in objects], dtype=np.float64)


def plan_message(plan: Plan) -> Any:
    """Return *plan* as a message; its values are not checked, as the simulation does that.

    Args:
        plan: of a planner; lists, or what else becomes an array, will do.

    Raises:
        ValueError: its arrays do not have the shapes of a plan, or hold no numbers.
    """
    arrays: dict[str, Any] = {name: np.asarray(getattr(plan, name)) for name in plan_arrays(plan)}
    given = replace(plan, **arrays)
    problem = form_problem(given, 0.0)
    if problem:
        raise ValueError(problem)
    exact = in_float64(given)
    if isinstance(exact, Controls):
        accel, steer = exact.accel_mps2.tolist(), exact.steer_rad.tolist()
        return messages.Plan(controls=messages.Controls(dt_s=exact.dt_s, accel_mps2=accel, steer_rad=steer))
    x, y = exact.xy_m.T.tolist()
    yaw, speed = exact.yaw_rad.tolist(), exact.speed_mps.tolist()
    return messages.Plan(
        trajectory=messages.Trajectory(dt_s=exact.dt_s, x_m=x, y_m=y, yaw_rad=yaw, speed_mps=speed)
    )


def plan_of(message: Any) -> Plan:
    """Return the plan in *message*.

    Raises:
        ValueError: there is none, or its arrays are not of one length.
    """
    kind = message.WhichOneof("plan")
    if kind is None:
        raise ValueError("answered without a plan; fill in trajectory or controls of the message Plan")
    body = getattr(message, kind)
    names = ("accel_mps2", "steer_rad") if kind == "controls" else ("x_m", "y_m", "yaw_rad", "speed_mps")
    arrays = [np.array(getattr(body, name), dtype=np.float64) for name in names]
    lengths = [len(array) for array in arrays]
    if len(set(lengths)) > 1:
        sizes = ", ".join(f"{name} {length}" for name, length in zip(names, lengths, strict=True))
        raise ValueError(f"answered with arrays of different lengths ({sizes}); send as many of each")
    if not lengths[0] or not body.dt_s > 0.0 or not np.isfinite(body.dt_s):
        raise ValueError(
            f"answered with a plan of {lengths[0]} steps of {body.dt_s:g} s; send at least one, and a positive dt_s"
        )
    if kind == "controls":
        return Controls(arrays[0], arrays[1], body.dt_s)
    return Trajectory(np.stack(arrays[:2], axis=-1), arrays[2], arrays[3], body.dt_s)
