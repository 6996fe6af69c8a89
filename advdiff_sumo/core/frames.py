"""Angles, rigid transforms, and conversions between SUMO's conventions and those of this package.

Ours: yaw in radians counter-clockwise from east, pose at the centre of the box.
SUMO's: angle in degrees clockwise from north, position at the centre of the front bumper.
"""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray


def wrap_angle(angle_rad: FloatArray | float) -> FloatArray:
    """Return *angle_rad* wrapped into (−π, π]; NaN stays NaN."""
    return np.asarray(wrapped(np.asarray(angle_rad, dtype=np.float64)))


def wrapped(angle_rad: FloatArray) -> FloatArray:
    """Return :func:`wrap_angle` of NumPy arrays or scalars; scalars stay scalars, which are faster than 0-d arrays."""
    return -((-angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


def yaw_from_sumo(angle_deg: FloatArray | float) -> FloatArray:
    """Return yaw (rad, counter-clockwise from east) of SUMO's *angle_deg* (clockwise from north)."""
    return wrap_angle(np.deg2rad(90.0 - np.asarray(angle_deg, dtype=np.float64)))


def sumo_from_yaw(yaw_rad: FloatArray | float) -> FloatArray:
    """Return SUMO's angle in degrees in [0, 360) of *yaw_rad*."""
    return np.asarray((90.0 - np.rad2deg(np.asarray(yaw_rad, dtype=np.float64))) % 360.0)


def centre_from_bumper(bumper_xy_m: FloatArray, yaw_rad: FloatArray, length_m: FloatArray) -> FloatArray:
    """Return box centres (…, 2) from front-bumper points (…, 2)."""
    return bumper_xy_m - 0.5 * length_m[..., None] * unit(yaw_rad)


def bumper_from_centre(centre_xy_m: FloatArray, yaw_rad: FloatArray, length_m: FloatArray) -> FloatArray:
    """Return front-bumper points (…, 2) from box centres (…, 2)."""
    return centre_xy_m + 0.5 * length_m[..., None] * unit(yaw_rad)


def unit(yaw_rad: FloatArray) -> FloatArray:
    """Return unit vectors (…, 2) that point along *yaw_rad* (…)."""
    return np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), axis=-1)


def local_from_world(
    xy_m: FloatArray, origin_xy_m: FloatArray, origin_yaw_rad: FloatArray | float
) -> FloatArray:
    """Return points (…, 2) in the frame at *origin_xy_m* whose x axis points along *origin_yaw_rad*."""
    cos, sin = np.cos(origin_yaw_rad), np.sin(origin_yaw_rad)
    delta = xy_m - origin_xy_m
    return np.stack(
        (cos * delta[..., 0] + sin * delta[..., 1], cos * delta[..., 1] - sin * delta[..., 0]), -1
    )
