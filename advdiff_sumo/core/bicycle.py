"""Kinematic bicycle, integrated exactly: constant acceleration and curvature drive along a circular arc.

Because the arc is exact, one step of 0.5 s and five of 0.1 s end in the same pose, so the decoder's 0.5 s
steps and the simulation's 0.1 s steps agree. The reference point is the box centre, without side slip (the
paper's "simplistic" model, Sec. III-B): curvature = tan(steer) / wheelbase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit, wrap_angle

WHEELBASE_PER_LENGTH = 0.6


@dataclass(frozen=True)
class Limits:
    """What a vehicle can do; refused or clipped beyond.

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

    All arrays are (…,) but *xy_m*, which is (…, 2).
    """
    stop_s = np.where(accel_mps2 < 0.0, speed_mps / np.maximum(-accel_mps2, 1e-9), np.inf)
    moving_s = np.minimum(np.maximum(stop_s, 0.0), dt_s)
    travelled = speed_mps * moving_s + 0.5 * accel_mps2 * moving_s**2
    turn = curvature_1pm * travelled
    half = 0.5 * turn
    chord = travelled * np.sinc(half / np.pi)  # sin(half) / half
    moved = xy_m + chord[..., None] * unit(yaw_rad + half)
    speed = np.where(stop_s <= dt_s, 0.0, speed_mps + accel_mps2 * dt_s)
    return moved, wrap_angle(yaw_rad + turn), speed


def clip_controls(
    speed_mps: FloatArray,
    accel_mps2: FloatArray,
    curvature_1pm: FloatArray,
    length_m: FloatArray,
    limits: Limits,
) -> tuple[FloatArray, FloatArray]:
    """Return acceleration and curvature within *limits* at *speed_mps*; all arrays (…,)."""
    accel = np.minimum(np.maximum(accel_mps2, -limits.brake_mps2), limits.accel_mps2)  # np.clip takes longer
    accel = np.where(speed_mps >= limits.speed_mps, np.minimum(accel, 0.0), accel)
    geometric = np.tan(limits.steer_rad) / wheelbase_m(length_m)
    grip = limits.lateral_mps2 / np.maximum(speed_mps, 0.1) ** 2
    bound = np.minimum(geometric, grip)
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
    """Return *states* of T instants, each (…, 2), (…,), (…,), as (…, T, 2), (…, T), (…, T)."""
    xy_m, yaw_rad, speed_mps = zip(*states, strict=True)
    return np.stack(xy_m, axis=-2), np.stack(yaw_rad, axis=-1), np.stack(speed_mps, axis=-1)
