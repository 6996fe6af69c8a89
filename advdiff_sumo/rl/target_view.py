"""The observation and the actions of the tested vehicle in its environment."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.frames import local_from_world, unit, wrap_angle
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap

OTHERS = 12
"""Number of nearest road users that are observed."""
AHEAD_M = (5.0, 10.0, 20.0, 30.0, 45.0)
"""Distances ahead at which the centre line is observed."""
POINTS = 4
"""Points of a trajectory action."""
_OWN, _OTHER = 5, 7
OBSERVED = _OWN + 2 * len(AHEAD_M) + OTHERS * _OTHER
LIMIT = 5.0
_POINT_S = 0.5
"""Time between the points of a trajectory action."""
_STEER_RAD, _SPEED_MPS, _LATERAL_STEP_M = 0.5, 20.0, 2.0
"""Steering angle, speed and lateral step for an action of 1."""


def observation(road: RoadMap, scene: Scene) -> FloatArray:
    """Return (OBSERVED,) features within ±LIMIT: own state, lane ahead, nearest others, in the target's frame.

    In this order, each divided by a typical value: speed, speed limit, offset from the lane (left positive), sine and
    cosine of the heading error; x and y of the centre line at ``AHEAD_M``; for each of the nearest others presence,
    x, y, relative velocity in x and y, length, width. Features of a missing lane or road user are 0.
    """
    now, target = scene.history, scene.target
    xy, yaw, speed = now.xy_m[target, -1], float(now.yaw_rad[target, -1]), float(now.speed_mps[target, -1])
    parts = _lane(road, scene, xy, yaw, speed), _others(scene, xy, yaw, speed)
    return np.clip(np.concatenate(parts), -LIMIT, LIMIT)


def _lane(road: RoadMap, scene: Scene, xy_m: FloatArray, yaw_rad: float, speed_mps: float) -> FloatArray:
    features = np.zeros(_OWN + 2 * len(AHEAD_M))
    features[0] = speed_mps / 15.0
    route = scene.routes[scene.target]
    pose = road.locate(xy_m, yaw_rad, route=route or None)
    paths = road.lane_path(route, pose.lane_id, 60.0, start_s_m=pose.s_m) if pose and route else []
    if pose is None or not paths:
        return features
    error = wrap_angle(pose.yaw_error_rad)
    features[1:5] = road.lanes[pose.lane_id].speed_mps / 15.0, pose.d_m / 2.0, np.sin(error), np.cos(error)
    points = paths[0].line.at(np.array(AHEAD_M), extrapolate=True)[0]
    features[5:] = local_from_world(points, xy_m, yaw_rad).ravel() / AHEAD_M[-1]
    return features


def _others(scene: Scene, xy_m: FloatArray, yaw_rad: float, speed_mps: float) -> FloatArray:
    now = scene.history
    present = now.valid[:, -1].copy()
    present[scene.target] = False
    rows = np.flatnonzero(present)
    distance = np.linalg.norm(now.xy_m[rows, -1] - xy_m, axis=-1)
    rows = rows[np.argsort(distance, kind="stable")][:OTHERS]
    features = np.zeros((OTHERS, _OTHER))
    position = local_from_world(now.xy_m[rows, -1], xy_m, yaw_rad)
    heading = unit(now.yaw_rad[rows, -1] - yaw_rad)
    velocity = now.speed_mps[rows, -1][:, None] * heading - np.array([speed_mps, 0.0])
    features[: len(rows), 0] = 1.0
    features[: len(rows), 1:3] = position / np.array([50.0, 20.0])
    features[: len(rows), 3:5] = velocity / 15.0
    features[: len(rows), 5:7] = now.size_m[rows] / np.array([10.0, 3.0])
    return features.ravel()


def controls_of(action: FloatArray) -> Controls:
    """Return the controls of an action (2,) in ±1: acceleration (−1: full braking) and steering (left positive)."""
    limits = Limits()
    full_mps2 = limits.accel_mps2 if action[0] >= 0.0 else limits.brake_mps2
    return Controls(np.full(5, action[0] * full_mps2), np.full(5, action[1] * _STEER_RAD), 0.1)


def trajectory_of(action: FloatArray, scene: Scene) -> Trajectory:
    """Return the trajectory of an action (2 · POINTS,) in ±1: speed and lateral step for each half second.

    A speed of −1 is 0 m/s, of 1 is 20 m/s. A lateral step of 1 is 2 m to the left of the present heading.
    """
    now, target = scene.history, scene.target
    speed = 0.5 * (action[0::2] + 1.0) * _SPEED_MPS
    forward, left = np.cumsum(speed * _POINT_S), np.cumsum(action[1::2] * _LATERAL_STEP_M)
    yaw = float(now.yaw_rad[target, -1])
    ahead, leftward = unit(np.asarray(yaw)), unit(np.asarray(yaw + 0.5 * np.pi))
    xy = now.xy_m[target, -1] + forward[:, None] * ahead + left[:, None] * leftward
    steps = np.diff(np.stack((forward, left), axis=-1), axis=0, prepend=np.zeros((1, 2)))
    turn = np.where(np.hypot(*steps.T) > 0.1, np.arctan2(steps[:, 1], np.maximum(steps[:, 0], 0.1)), 0.0)
    return Trajectory(xy, yaw + turn, speed, _POINT_S)


def plan_of_action(action: FloatArray, scene: Scene) -> Plan:
    """Return the plan of *action*: controls for two numbers, a trajectory for ``2 · POINTS``."""
    return controls_of(action) if len(action) == 2 else trajectory_of(action, scene)
