"""Make scenes by hand, and run a loop without SUMO in which the others keep their speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import AgentClass, Scene, Tracks
from advdiff_sumo.core.tracking import drive_plan
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_protocol import Planner

CAR_M = (4.6, 1.8)
STEP_S, DT_S, HISTORY = 0.1, 0.5, 5


@dataclass(frozen=True)
class Car:
    """A car on a lane: ``s_m`` of its centre, lateral offset, speed."""

    lane: str
    s_m: float
    speed_mps: float = 0.0
    d_m: float = 0.0


def make_scene(
    road: RoadMap, cars: Sequence[Car], route: tuple[str, ...], signals: Mapping[str, str] | None = None
) -> Scene:
    """Return a scene of *cars* with constant speed so far; the first one is the target."""
    xy, yaw = zip(*(road.to_world(car.lane, car.s_m, car.d_m) for car in cars), strict=True)
    poses, yaws = np.array(xy), np.array(yaw, dtype=np.float64)
    speed = np.array([car.speed_mps for car in cars])
    back = DT_S * np.arange(HISTORY - 1, -1, -1)
    past = poses[:, None] - (speed[:, None] * back)[..., None] * unit(yaws)[:, None]
    history = Tracks(
        ids=tuple(f"car{k}" for k in range(len(cars))),
        classes=np.full(len(cars), int(AgentClass.CAR)),
        size_m=np.tile(CAR_M, (len(cars), 1)),
        xy_m=past,
        yaw_rad=np.repeat(yaws[:, None], HISTORY, 1),
        speed_mps=np.repeat(speed[:, None], HISTORY, 1),
        valid=np.ones((len(cars), HISTORY), dtype=np.bool_),
        t0_s=-2.0,
        dt_s=DT_S,
    )
    routes = (route, *(() for _ in cars[1:]))
    return Scene(history, 0, np.zeros(len(cars), dtype=np.bool_), routes, dict(signals or {}))


def roll(road: RoadMap, planner: Planner, scene: Scene, seconds: float) -> Tracks:
    """Return the tracks at every half second: the target follows its plans, the others drive straight on."""
    rng = np.random.default_rng(0)
    memory = planner.start(road, scene, rng)
    frames = [scene.history.window(HISTORY - 1, HISTORY)]
    for _ in range(round(seconds / DT_S)):
        plan, memory = planner.plan(road, scene, memory, rng)
        scene = _advance(scene, plan)
        frames.append(scene.history.window(HISTORY - 1, HISTORY))
    parts = {
        name: np.concatenate([getattr(f, name) for f in frames], axis=1)
        for name in ("xy_m", "yaw_rad", "speed_mps", "valid")
    }
    return replace(frames[0], **parts, t0_s=0.0)


def _advance(scene: Scene, plan: object) -> Scene:
    old = scene.history
    xy, yaw, speed = old.xy_m[:, -1].copy(), old.yaw_rad[:, -1].copy(), old.speed_mps[:, -1].copy()
    xy += DT_S * speed[:, None] * unit(yaw)
    start = (old.xy_m[0, -1], old.yaw_rad[0, -1], old.speed_mps[0, -1])
    driven = drive_plan(start, plan, old.size_m[0, 0], STEP_S, round(DT_S / STEP_S), Limits())  # type: ignore[arg-type] # a plan
    xy[0], yaw[0], speed[0] = driven[0][-1], driven[1][-1], driven[2][-1]
    history = replace(
        old,
        xy_m=np.concatenate((old.xy_m[:, 1:], xy[:, None]), 1),
        yaw_rad=np.concatenate((old.yaw_rad[:, 1:], yaw[:, None]), 1),
        speed_mps=np.concatenate((old.speed_mps[:, 1:], speed[:, None]), 1),
        t0_s=old.t0_s + DT_S,
    )
    return replace(scene, history=history)
