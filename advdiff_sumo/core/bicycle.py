"""Kinematic bicycle model, integrated exactly: constant acceleration and curvature give a circular arc.

Because the arc is exact, one step of 0.5 s and five of 0.1 s end in the same pose, so the decoder's 0.5 s
steps and the simulation's 0.1 s steps agree. The reference point is the box centre, without side slip (the
paper's "simplistic" model, Sec. III-B): curvature = tan(steer) / wheelbase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrapped

WHEELBASE_PER_LENGTH = 0.6
_TINY_RAD = float(np.finfo(np.float64).eps)
"""Replaces a turn of 0, so that the ratio of chord to arc is 1."""


@dataclass(frozen=True)
class Limits:
    """Limits of a vehicle; values beyond them are refused or clipped.

    Attributes:
        accel_mps2: strongest acceleration.
        brake_mps2: strongest deceleration, positive.
        lateral_mps2: strongest lateral acceleration.
        steer_rad: largest front-wheel angle.
        speed_mps: highest speed.
    """

    accel_mps2: float = 4.0
    brake_mps2: float = 9.0
    lateral_mps2: float = 6.0
    steer_rad: float = 0.6
    speed_mps: float = 60.0


def wheelbase_m(length_m: FloatArray | float) -> FloatArray:
    """Return the wheelbase of vehicles of *length_m*."""
    return np.asarray(WHEELBASE_PER_LENGTH * np.asarray(length_m, dtype=np.float64))


def step(
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    accel_mps2: FloatArray,
    curvature_1pm: FloatArray,
    dt_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pose and speed after *dt_s*; the vehicle stops at zero speed and does not reverse.

    All arrays are (…,), except *xy_m*, which is (…, 2).
    """
    x, y, yaw, speed = advance(
        xy_m[..., 0], xy_m[..., 1], yaw_rad, speed_mps, accel_mps2, curvature_1pm, dt_s
    )
    return np.stack((x, y), axis=-1), np.asarray(yaw), np.asarray(speed)


def advance(
    x_m: FloatArray,
    y_m: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    accel_mps2: FloatArray,
    curvature_1pm: FloatArray,
    dt_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the result of :func:`step` as separate x, y, yaw and speed (…,)."""
    stop_s = np.where(accel_mps2 < 0.0, speed_mps / np.maximum(-accel_mps2, 1e-9), np.inf)
    moving_s = np.minimum(np.maximum(stop_s, 0.0), dt_s)
    travelled = speed_mps * moving_s + 0.5 * accel_mps2 * moving_s**2
    turn = curvature_1pm * travelled
    half_turn = 0.5 * turn
    angle = np.pi * (half_turn / np.pi)  # rounded as in np.sinc
    angle = np.where(angle, angle, _TINY_RAD)
    chord = travelled * (np.sin(angle) / angle)
    chord_yaw = yaw_rad + half_turn
    speed = np.where(stop_s <= dt_s, 0.0, speed_mps + accel_mps2 * dt_s)
    x, y = x_m + chord * np.cos(chord_yaw), y_m + chord * np.sin(chord_yaw)
    return x, y, wrapped(yaw_rad + turn), speed[()]


def clip_controls(
    speed_mps: FloatArray,
    accel_mps2: FloatArray,
    curvature_1pm: FloatArray,
    length_m: FloatArray,
    limits: Limits,
) -> tuple[FloatArray, FloatArray]:
    """Return acceleration and curvature within *limits* at *speed_mps*; all arrays (…,)."""
    return bounded_controls(
        speed_mps, accel_mps2, curvature_1pm, tightest_curvature_1pm(length_m, limits), limits
    )


def tightest_curvature_1pm(length_m: FloatArray, limits: Limits) -> FloatArray:
    """Return the curvature (…,) of vehicles of *length_m* (…,) at the largest steering angle of *limits*."""
    return np.asarray(np.tan(limits.steer_rad) / wheelbase_m(length_m))


def bounded_controls(
    speed_mps: FloatArray,
    accel_mps2: FloatArray,
    curvature_1pm: FloatArray,
    tightest_1pm: FloatArray,
    limits: Limits,
) -> tuple[FloatArray, FloatArray]:
    """Return :func:`clip_controls` for vehicles whose :func:`tightest_curvature_1pm` is known; all arrays (…,)."""
    accel = np.minimum(np.maximum(accel_mps2, -limits.brake_mps2), limits.accel_mps2)
    accel = np.where(speed_mps >= limits.speed_mps, np.minimum(accel, 0.0), accel)[()]
    lateral_bound = limits.lateral_mps2 / np.maximum(speed_mps, 0.1) ** 2
    bound = np.minimum(tightest_1pm, lateral_bound)
    return accel, np.minimum(np.maximum(curvature_1pm, -bound), bound)


def rollout(
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    accel_mps2: FloatArray,
    curvature_1pm: FloatArray,
    dt_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return states (…, T, 2), (…, T), (…, T) after each of T controls (…, T) held for *dt_s*."""
    states = []
    for t in range(accel_mps2.shape[-1]):
        xy_m, yaw_rad, speed_mps = step(
            xy_m, yaw_rad, speed_mps, accel_mps2[..., t], curvature_1pm[..., t], dt_s
        )
        states.append((xy_m, yaw_rad, speed_mps))
    return stacked(states)


def stacked(
    states: Sequence[tuple[FloatArray, FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return *states* at T instants, each (…, 2), (…,), (…,), as arrays (…, T, 2), (…, T), (…, T)."""
    xy_m, yaw_rad, speed_mps = zip(*states, strict=True)
    return np.stack(xy_m, axis=-2), np.stack(yaw_rad, axis=-1), np.stack(speed_mps, axis=-1)
