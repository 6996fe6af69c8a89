"""What the tested vehicle observes in the environment, and what its actions mean."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.frames import local_from_world, unit, wrap_angle
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap

OTHERS, AHEAD_M = 12, (5.0, 10.0, 20.0, 30.0, 45.0)
POINTS = 4
_OWN, _OTHER = 5, 7
OBSERVED = _OWN + 2 * len(AHEAD_M) + OTHERS * _OTHER
LIMIT = 5.0
_STEER_RAD, _POINT_S, _SPEED_MPS, _SIDE_M = 0.5, 0.5, 20.0, 2.0


def observation(road: RoadMap, scene: Scene) -> FloatArray:
    """Return (OBSERVED,) numbers within ±LIMIT: own state, the lane ahead, the nearest others; own frame.

    In this order, each divided by a usual size: speed, speed limit, offset from the lane (left positive), sine and
    cosine of the heading against the lane; x and y of the centre line at ``AHEAD_M``; for the nearest others whether
    there is one, x, y, velocity in x and y against the own one, length, width. Zeros where there is no lane or nobody.
    """
    now, me = scene.history, scene.target
    xy, yaw, speed = now.xy_m[me, -1], float(now.yaw_rad[me, -1]), float(now.speed_mps[me, -1])
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
    there = now.valid[:, -1].copy()
    there[scene.target] = False
    rows = np.flatnonzero(there)
    gap = np.linalg.norm(now.xy_m[rows, -1] - xy_m, axis=-1)
    rows = rows[np.argsort(gap, kind="stable")][:OTHERS]
    features = np.zeros((OTHERS, _OTHER))
    place = local_from_world(now.xy_m[rows, -1], xy_m, yaw_rad)
    heading = unit(now.yaw_rad[rows, -1] - yaw_rad)
    velocity = now.speed_mps[rows, -1][:, None] * heading - np.array([speed_mps, 0.0])
    features[: len(rows), 0] = 1.0
    features[: len(rows), 1:3] = place / np.array([50.0, 20.0])
    features[: len(rows), 3:5] = velocity / 15.0
    features[: len(rows), 5:7] = now.size_m[rows] / np.array([10.0, 3.0])
    return features.ravel()


def controls_of(action: FloatArray) -> Controls:
    """Return what (2,) numbers in ±1 ask for: acceleration (−1 full braking, 1 full) and steering (left positive)."""
    limits = Limits()
    strongest = limits.accel_mps2 if action[0] >= 0.0 else limits.brake_mps2
    return Controls(np.full(5, action[0] * strongest), np.full(5, action[1] * _STEER_RAD), 0.1)


def trajectory_of(action: FloatArray, scene: Scene) -> Trajectory:
    """Return what (2 · POINTS,) numbers in ±1 ask for: speed and step to the left of each half second.

    A speed of −1 is standing, 1 is 20 m/s; a step of 1 is 2 m to the left of the heading now.
    """
    now, me = scene.history, scene.target
    speed = 0.5 * (action[0::2] + 1.0) * _SPEED_MPS
    forward, left = np.cumsum(speed * _POINT_S), np.cumsum(action[1::2] * _SIDE_M)
    yaw = float(now.yaw_rad[me, -1])
    ahead, beside = unit(np.asarray(yaw)), unit(np.asarray(yaw + 0.5 * np.pi))
    xy = now.xy_m[me, -1] + forward[:, None] * ahead + left[:, None] * beside
    steps = np.diff(np.stack((forward, left), axis=-1), axis=0, prepend=np.zeros((1, 2)))
    turned = np.where(np.hypot(*steps.T) > 0.1, np.arctan2(steps[:, 1], np.maximum(steps[:, 0], 0.1)), 0.0)
    return Trajectory(xy, yaw + turned, speed, _POINT_S)


def plan_of_action(action: FloatArray, scene: Scene) -> Plan:
    """Return the plan that *action* asks for: controls of two numbers, a trajectory of ``2 · POINTS``."""
    return controls_of(action) if len(action) == 2 else trajectory_of(action, scene)
