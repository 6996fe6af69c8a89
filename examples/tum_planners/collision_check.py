"""Collision objects of CommonRoad's drivability checker: the predicted other road users, and the road's edges."""

from __future__ import annotations

import commonroad_dc.pycrcc as pycrcc
import numpy as np
from adapter import REAR_AXLE_M, OwnFrame
from commonroad_dc.collision.trajectory_queries.trajectory_queries import trajectory_preprocess_obb_sum

_RANGE_M, _HALF_EDGE_M = 80.0, 0.01


def checker_of(
    frame: OwnFrame, poses: np.ndarray, sizes_m: np.ndarray, boundary_m: np.ndarray, continuous: bool
):
    """Return a collision checker in *frame*.

    Args:
        frame: the vehicle's frame.
        poses: (A, T, 3) predicted poses of the others in the world's frame.
        sizes_m: (A, 2) their boxes.
        boundary_m: (K, 2, 2) edges of the road in the world's frame.
        continuous: whether the movement between poses is covered, too.
    """
    checker = pycrcc.CollisionChecker()
    for pose, (length, width) in zip(poses, sizes_m, strict=True):
        xy, yaw = frame.from_world(pose[:, :2]), pose[:, 2] - frame.yaw_rad
        checker.add_collision_object(moving_box(xy, yaw, length, width, continuous))
    checker.add_collision_object(_edges(frame, boundary_m))
    return checker


def moving_box(xy_m: np.ndarray, yaw_rad: np.ndarray, length_m: float, width_m: float, continuous: bool):
    """Return a box that moves through centres (T, 2); *continuous*: the area between them is covered, too."""
    moving = pycrcc.TimeVariantCollisionObject(0)
    for (x, y), yaw in zip(xy_m, yaw_rad, strict=True):
        moving.append_obstacle(pycrcc.RectOBB(0.5 * length_m, 0.5 * width_m, yaw, x, y))
    if not continuous:
        return moving
    hull, failed = trajectory_preprocess_obb_sum(moving)
    return moving if failed else hull


def own_box(axle_m: np.ndarray, yaw_rad: np.ndarray, size_m: np.ndarray):
    """Return the moving box of the planning vehicle, given positions (T, 2) of its rear axle."""
    centre = axle_m + REAR_AXLE_M * np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), axis=-1)
    return moving_box(centre, yaw_rad, float(size_m[0]), float(size_m[1]), continuous=True)


def _edges(frame: OwnFrame, boundary_m: np.ndarray):
    group = pycrcc.ShapeGroup()
    near = boundary_m[(np.abs(boundary_m - frame.xy_m) < _RANGE_M).all(axis=2).any(axis=1)]
    for first, second in frame.from_world(near):
        (x, y), (dx, dy) = 0.5 * (first + second), second - first
        group.add_shape(
            pycrcc.RectOBB(0.5 * float(np.hypot(dx, dy)), _HALF_EDGE_M, float(np.arctan2(dy, dx)), x, y)
        )
    return group
