"""A step of the bicycle model from unbounded numbers, as ``models.tensor_bicycle``, with its gradient."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.bicycle import WHEELBASE_PER_LENGTH
from advdiff_sumo.models.model_options import MODEL_STEP_S, ModelOptions
from advdiff_sumo.traffic.baselines.joint.joint_arrays import Array

_LEAST_MPS = 0.1
_SERIES = 1e-2
"""Below this angle the slope of sin(x) / x comes from its series: the difference of two near ones has few digits."""


@dataclass(frozen=True)
class Cars:
    """A agents.

    Attributes:
        begin: (A, 4) x, y, yaw, speed now.
        tightest: (A,) curvature that the steering angle allows.
        moved: (A,) 1 for vehicles, 0 for who keeps the velocity.
        options: with the other bounds.
    """

    begin: Array
    tightest: Array
    moved: Array
    options: ModelOptions

    @staticmethod
    def of(pose: Array, length: Array, moved: Array, options: ModelOptions) -> Cars:
        """Return agents at *pose* (A, 4) of *length* (A,)."""
        wheelbase = WHEELBASE_PER_LENGTH * np.maximum(length, 0.5)
        return Cars(
            pose,
            math.tan(options.steer_rad) / wheelbase,
            np.where(moved, 1.0, 0.0).astype(pose.dtype),
            options,
        )


@dataclass(frozen=True)
class Driven:
    """One step, as its gradient needs it; each (A,).

    Attributes:
        yaw, speed: before it.
        pressed, turned: hyperbolic tangents of both raw numbers.
        limit: of the curvature.
        slope: of that limit by the speed.
        accel, curvature: what is driven.
    """

    yaw: Array
    speed: Array
    pressed: Array
    turned: Array
    limit: Array
    slope: Array
    accel: Array
    curvature: Array


def drive(cars: Cars, raw: Array, motion: Array) -> tuple[Array, Driven]:
    """Return the motion (A, 4) x, y, yaw, speed after a step, and the step, for *raw* (A, 2)."""
    yaw, speed = motion[:, 2], motion[:, 3]
    bound = np.where(raw[:, 0] > 0.0, cars.options.accel_mps2, cars.options.brake_mps2).astype(raw.dtype)
    pressed, turned = np.tanh(raw[:, 0] / bound), np.tanh(raw[:, 1])
    fast = np.maximum(speed, _LEAST_MPS)
    grip = cars.options.lateral_mps2 / fast**2
    limit = np.minimum(cars.tightest, grip)
    slope = np.where((grip < cars.tightest) & (speed >= _LEAST_MPS), -2.0 * grip / fast, 0.0)
    accel, curvature = bound * pressed * cars.moved, limit * turned * cars.moved
    done = Driven(yaw, speed, pressed, turned, limit, slope, accel, curvature)
    _, way, half = _arc(done)
    chord, heading = way * np.sinc(half / math.pi), yaw + half
    after = np.empty_like(motion)
    after[:, 0] = motion[:, 0] + chord * np.cos(heading)
    after[:, 1] = motion[:, 1] + chord * np.sin(heading)
    after[:, 2] = yaw + 2.0 * half
    after[:, 3] = np.maximum(speed + accel * MODEL_STEP_S, 0.0)
    return after, done


def drive_back(cars: Cars, done: Driven, grad: Array, controls: Array) -> tuple[Array, Array]:
    """Return the gradients of the raw numbers (A, 2) and of the motion before (A, 4).

    How long a vehicle moves needs none: where it stops, it moves no more at its end.

    Args:
        cars: agents.
        done: the step.
        grad: (A, 4) gradient of the motion after it.
        controls: (A, 2) gradient of acceleration and curvature.
    """
    moving, way, half = _arc(done)
    share, heading = np.sinc(half / math.pi), done.yaw + half
    cos, sin = np.cos(heading), np.sin(heading)
    by_chord = grad[:, 0] * cos + grad[:, 1] * sin
    by_heading = way * share * (grad[:, 1] * cos - grad[:, 0] * sin)
    by_half = by_heading + 2.0 * grad[:, 2] + by_chord * way * _sinc_slope(half, share)
    by_way = by_chord * share + 0.5 * done.curvature * by_half
    goes = np.where(done.speed + done.accel * MODEL_STEP_S >= 0.0, grad[:, 3], 0.0)
    by_accel = (controls[:, 0] + 0.5 * moving**2 * by_way + MODEL_STEP_S * goes) * cars.moved
    by_curvature = (controls[:, 1] + 0.5 * way * by_half) * cars.moved
    raw = np.stack(
        (by_accel * (1.0 - done.pressed**2), by_curvature * done.limit * (1.0 - done.turned**2)), axis=-1
    )
    before = grad.copy()
    before[:, 2] += by_heading
    before[:, 3] = moving * by_way + goes + by_curvature * done.turned * done.slope
    return raw, before


def _arc(done: Driven) -> tuple[Array, Array, Array]:
    """Return how long agents move in the step, how far, and half the angle that they turn by."""
    brakes = done.accel < 0.0
    stop_s = done.speed / np.where(brakes, np.maximum(-done.accel, 1e-6), 1.0)
    moving = np.where(brakes, np.minimum(stop_s, MODEL_STEP_S), MODEL_STEP_S).astype(done.speed.dtype)
    way = done.speed * moving + 0.5 * done.accel * moving**2
    return moving, way, 0.5 * done.curvature * way


def _sinc_slope(x: Array, share: Array) -> Array:
    small = np.abs(x) < _SERIES
    series = -x / 3.0 * (1.0 - 0.1 * x * x)
    value: Array = np.where(small, series, (np.cos(x) - share) / np.where(small, 1.0, x))
    return value
