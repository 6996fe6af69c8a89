"""Converts scenes and plans to messages and back, without changing a bit."""

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
    """Return *scene* as a message, without what a planner must not know: the other routes and the movable agents."""
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
    """Return the scene in *message*; no agent is movable, and the routes of all agents but the target are empty."""
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
        plan: plan of a planner; its arrays may be lists or anything else that NumPy converts to arrays.

    Raises:
        ValueError: the arrays do not have the shapes of a plan, or do not contain numbers.
    """
    arrays: dict[str, Any] = {name: np.asarray(getattr(plan, name)) for name in plan_arrays(plan)}
    with_arrays = replace(plan, **arrays)
    problem = form_problem(with_arrays, 0.0)
    if problem:
        raise ValueError(problem)
    plan64 = in_float64(with_arrays)
    if isinstance(plan64, Controls):
        accel, steer = plan64.accel_mps2.tolist(), plan64.steer_rad.tolist()
        return messages.Plan(controls=messages.Controls(dt_s=plan64.dt_s, accel_mps2=accel, steer_rad=steer))
    x, y = plan64.xy_m.T.tolist()
    yaw, speed = plan64.yaw_rad.tolist(), plan64.speed_mps.tolist()
    return messages.Plan(
        trajectory=messages.Trajectory(dt_s=plan64.dt_s, x_m=x, y_m=y, yaw_rad=yaw, speed_mps=speed)
    )


def plan_of(message: Any) -> Plan:
    """Return the plan in *message*.

    Raises:
        ValueError: there is no plan, its arrays are empty or of different lengths, or its time step is not positive.
    """
    kind = message.WhichOneof("plan")
    if kind is None:
        raise ValueError("answered without a plan; fill in trajectory or controls of the message Plan")
    plan = getattr(message, kind)
    names = ("accel_mps2", "steer_rad") if kind == "controls" else ("x_m", "y_m", "yaw_rad", "speed_mps")
    arrays = [np.array(getattr(plan, name), dtype=np.float64) for name in names]
    lengths = [len(array) for array in arrays]
    if len(set(lengths)) > 1:
        sizes = ", ".join(f"{name} {length}" for name, length in zip(names, lengths, strict=True))
        raise ValueError(f"answered with arrays of different lengths ({sizes}); send as many of each")
    if not lengths[0] or not plan.dt_s > 0.0 or not np.isfinite(plan.dt_s):
        raise ValueError(
            f"answered with a plan of {lengths[0]} steps of {plan.dt_s:g} s; send at least one, and a positive dt_s"
        )
    if kind == "controls":
        return Controls(arrays[0], arrays[1], plan.dt_s)
    return Trajectory(np.stack(arrays[:2], axis=-1), arrays[2], arrays[3], plan.dt_s)
