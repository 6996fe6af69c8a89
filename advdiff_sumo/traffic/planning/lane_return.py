"""Drives vehicles that nobody plans for any more along their lanes, among everybody else, until SUMO can take them.

They go on along their lanes, under the safeguard, so that who is left in a turn clears the junction in the gaps of
the others.
"""

from __future__ import annotations

import math

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.scene import MOTOR_CLASSES, AgentClass, Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S
from advdiff_sumo.traffic.licence import NATURAL_OVER_LIMIT
from advdiff_sumo.traffic.planning.futures import Futures, coasting
from advdiff_sumo.traffic.planning.lanes_ahead import lanes_ahead
from advdiff_sumo.traffic.planning.people import PEOPLE
from advdiff_sumo.traffic.planning.planned_paths import PlannedPaths, speeds_of_strides
from advdiff_sumo.traffic.planning.safeguard import LOST_BRAKE_MPS2, SafeguardInput, back_to_lane, safeguard
from advdiff_sumo.traffic.planning.way_out import way_out


def return_to_lanes(road: RoadMap, scene: Scene, duration_s: float, plans: Tracks | None = None) -> Futures:
    """Return what everybody in *scene* does for *duration_s* or longer, where movable vehicles follow their lanes.

    The others drive as planned; who has no plan goes along its lane, no faster than now, or straight on. A movable
    vehicle that is on no lane stops.

    Args:
        road: the map.
        scene: an instant; its history may be of now alone.
        duration_s: for which the futures are needed at least.
        plans: of others, whose first instant is one model step from now; of another spacing they are not read.
    """
    now = scene.history
    state = now.xy_m[:, -1], now.yaw_rad[:, -1], now.speed_mps[:, -1]
    watched = _watched(road, scene)
    drives = np.array([lane is not None for lane in watched.lanes]) & (now.classes != AgentClass.PEDESTRIAN)
    steps = max(FUTURE_STEPS, math.ceil(duration_s / MODEL_STEP_S))
    futures = coasting(*state, now.size_m, steps, MODEL_STEP_S)
    _brake_to_stand(futures, watched.planned & ~drives)
    back_to_lane(futures, np.flatnonzero(drives), watched)
    _keep_speed(futures, drives & ~watched.planned)
    if plans is not None and abs(plans.dt_s - MODEL_STEP_S) < 1e-9:
        _as_planned(futures, scene, plans)
    return safeguard(road, futures, watched).futures


def _watched(road: RoadMap, scene: Scene) -> SafeguardInput:
    """Return what the safeguard has to know: of what was before now it knows nothing."""
    now, nobody = scene.history, np.zeros(scene.history.agents, dtype=np.bool_)
    xy, yaw = now.xy_m[:, -1], now.yaw_rad[:, -1]
    lanes = lanes_ahead(road, xy, yaw, scene.routes)
    for row in np.flatnonzero(scene.movable).tolist():
        lanes[row] = lanes[row] or way_out(road, xy[row], float(yaw[row]))
    return SafeguardInput(
        planned=scene.movable,
        attacker=nobody,
        target=scene.target,
        motor=np.isin(now.classes, MOTOR_CLASSES),
        people=np.isin(now.classes, PEOPLE),
        stood=nobody,
        dawdled=nobody,
        over_limit=np.where(scene.movable, NATURAL_OVER_LIMIT, 1.0),
        lanes=lanes,
        signals=scene.signals,
        waits_m=np.full(now.agents, np.inf),
    )


def _brake_to_stand(futures: Futures, rows: BoolArray) -> None:
    """Let *rows* (N,) stop straight ahead, in place."""
    time, paths = futures.dt_s * np.arange(1, futures.steps + 1), PlannedPaths(futures.copy())
    for row in np.flatnonzero(rows).tolist():
        speed = max(float(futures.speed_mps[row, 0]), 0.0)
        moving = np.minimum(time, speed / LOST_BRAKE_MPS2)
        xy, yaw = paths.at(row, speed * moving - 0.5 * LOST_BRAKE_MPS2 * moving**2)
        futures.put(row, xy, yaw, speed - LOST_BRAKE_MPS2 * moving)


def _keep_speed(futures: Futures, rows: BoolArray) -> None:
    """Let *rows* (N,) drive their paths no faster than now, in place."""
    paths = PlannedPaths(futures.copy())
    time = futures.dt_s * np.arange(futures.steps + 1)
    for row in np.flatnonzero(rows).tolist():
        driven = np.minimum(paths.s_m[row], max(float(futures.speed_mps[row, 0]), 0.0) * time)
        xy, yaw = paths.at(row, driven[1:])
        futures.put(row, xy, yaw, speeds_of_strides(np.diff(driven), futures.dt_s))


def _as_planned(futures: Futures, scene: Scene, plans: Tracks) -> None:
    """Let those drive as *plans* say that have one for all its instants, going on at its last velocity, in place."""
    pairs = [
        (row, plans.index[name])
        for row, name in enumerate(scene.history.ids)
        if name in plans.index and not scene.movable[row] and plans.valid[plans.index[name]].all()
    ]
    if not pairs:
        return
    rows, agents = np.array(pairs).T
    planned = Futures(
        np.concatenate((futures.xy_m[rows, :1], plans.xy_m[agents]), axis=1),
        np.concatenate((futures.yaw_rad[rows, :1], plans.yaw_rad[agents]), axis=1),
        np.concatenate((futures.speed_mps[rows, :1], plans.speed_mps[agents]), axis=1),
        futures.size_m[rows],
        futures.dt_s,
    ).lasting(futures.steps)
    futures.xy_m[rows], futures.yaw_rad[rows] = planned.xy_m, planned.yaw_rad
    futures.speed_mps[rows] = planned.speed_mps
