"""Drives vehicles that have no plan any more along their lanes until SUMO can take them back.

They pass through the safeguard. A vehicle left in the middle of a turn thus clears the junction in a gap of traffic.
"""

from __future__ import annotations

import math

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.scene import MOTOR_CLASSES, AgentClass, Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S
from advdiff_sumo.traffic.licence import NATURAL_OVER_LIMIT
from advdiff_sumo.traffic.planning.futures import Futures, constant_velocity_futures
from advdiff_sumo.traffic.planning.lanes_ahead import lanes_ahead
from advdiff_sumo.traffic.planning.people import PEOPLE
from advdiff_sumo.traffic.planning.planned_paths import PlannedPaths, speeds_of_strides
from advdiff_sumo.traffic.planning.safeguard import LOST_BRAKE_MPS2, SafeguardInput, back_to_lane, safeguard
from advdiff_sumo.traffic.planning.way_out import way_out


def return_to_lanes(road: RoadMap, scene: Scene, duration_s: float, plans: Tracks | None = None) -> Futures:
    """Return futures of all road users in *scene* in which the movable vehicles follow their lanes.

    A movable vehicle on no lane stops. The others drive as planned; those without a plan follow their lanes, no
    faster than now, or go straight on where there is none.

    Args:
        road: the map.
        scene: an instant; its history may hold the present alone.
        duration_s: shortest duration of the futures.
        plans: plans of others, from one model step after now; ignored if their spacing is not the model step.
    """
    now = scene.history
    present = now.xy_m[:, -1], now.yaw_rad[:, -1], now.speed_mps[:, -1]
    inputs = _safeguard_input(road, scene)
    on_lane = np.array([lane is not None for lane in inputs.lanes]) & (now.classes != AgentClass.PEDESTRIAN)
    steps = max(FUTURE_STEPS, math.ceil(duration_s / MODEL_STEP_S))
    futures = constant_velocity_futures(*present, now.size_m, steps, MODEL_STEP_S)
    _brake_to_standstill(futures, inputs.is_planned & ~on_lane)
    back_to_lane(futures, np.flatnonzero(on_lane), inputs)
    _bound_to_present_speed(futures, on_lane & ~inputs.is_planned)
    if plans is not None and abs(plans.dt_s - MODEL_STEP_S) < 1e-9:
        _apply_plans(futures, scene, plans)
    return safeguard(road, futures, inputs).futures


def _safeguard_input(road: RoadMap, scene: Scene) -> SafeguardInput:
    """Return the input of the safeguard, without knowledge of the past."""
    now, none = scene.history, np.zeros(scene.history.agents, dtype=np.bool_)
    xy, yaw = now.xy_m[:, -1], now.yaw_rad[:, -1]
    lanes = lanes_ahead(road, xy, yaw, scene.routes)
    for row in np.flatnonzero(scene.movable).tolist():
        lanes[row] = lanes[row] or way_out(road, xy[row], float(yaw[row]))
    return SafeguardInput(
        is_planned=scene.movable,
        is_attacker=none,
        target=scene.target,
        is_motor=np.isin(now.classes, MOTOR_CLASSES),
        is_unprotected=np.isin(now.classes, PEOPLE),
        has_stood=none,
        has_crept=none,
        limit_share=np.where(scene.movable, NATURAL_OVER_LIMIT, 1.0),
        lanes=lanes,
        signals=scene.signals,
        yield_stop_m=np.full(now.agents, np.inf),
    )


def _brake_to_standstill(futures: Futures, rows: BoolArray) -> None:
    """Let *rows* (N,) stop straight ahead, in place."""
    time, paths = futures.dt_s * np.arange(1, futures.steps + 1), PlannedPaths(futures.copy())
    for row in np.flatnonzero(rows).tolist():
        speed = max(float(futures.speed_mps[row, 0]), 0.0)
        moving = np.minimum(time, speed / LOST_BRAKE_MPS2)
        xy, yaw = paths.at(row, speed * moving - 0.5 * LOST_BRAKE_MPS2 * moving**2)
        futures.put(row, xy, yaw, speed - LOST_BRAKE_MPS2 * moving)


def _bound_to_present_speed(futures: Futures, rows: BoolArray) -> None:
    """Let *rows* (N,) drive their paths no faster than they are now, in place."""
    paths = PlannedPaths(futures.copy())
    time = futures.dt_s * np.arange(futures.steps + 1)
    for row in np.flatnonzero(rows).tolist():
        driven = np.minimum(paths.s_m[row], max(float(futures.speed_mps[row, 0]), 0.0) * time)
        xy, yaw = paths.at(row, driven[1:])
        futures.put(row, xy, yaw, speeds_of_strides(np.diff(driven), futures.dt_s))


def _apply_plans(futures: Futures, scene: Scene, plans: Tracks) -> None:
    """Overwrite the futures of vehicles that are not movable with their plans, in place.

    A plan that is not valid at all instants is ignored. Plans continue at their last velocity.
    """
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
