"""The decoder's vehicle on NumPy arrays, with its gradient by hand: controls, arc, and what it sees of itself.

The same functions as ``models.bicycle`` and ``models.geometry``, equal up to rounding; for a few dozen numbers each
NumPy call takes a fraction of a tensor's. Arrays are (N,) and of one precision, that of the networks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from advdiff_sumo.core.bicycle import WHEELBASE_PER_LENGTH
from advdiff_sumo.models.options import MODEL_STEP_S, ModelOptions

Array: TypeAlias = NDArray[np.floating[Any]]

MOTION = 6
_PLACE_SCALE, _SPEED_SCALE = 0.05, 0.1
_LEAST_MPS, _LEAST_LENGTH_M = 0.1, 0.5
_SERIES = 0.03  # below it the slope of sin x / x by its series, which loses no digits


def blank(shape: tuple[int, ...], like: Array) -> Array:
    """Return an array that begins where PyTorch's do.

    A product's last digits depend on how its factors lie in memory; NumPy's own arrays lie elsewhere each time.
    """
    made: Array = torch.empty(
        shape, dtype=torch.float64 if like.dtype == np.float64 else torch.float32
    ).numpy()
    return made


@dataclass(frozen=True)
class Vehicles:
    """N vehicles and where they are now.

    Attributes:
        x, y, yaw, speed: (N,) the present, to which motion is relative.
        steep: (N,) largest curvature by steering.
        moved: (N,) 1 for vehicles, 0 for others, which keep their velocity.
        options: limits.
    """

    x: Array
    y: Array
    yaw: Array
    speed: Array
    steep: Array
    moved: Array
    options: ModelOptions

    @staticmethod
    def of(pose: Array, length: Array, moved: Array, options: ModelOptions) -> Vehicles:
        """Return vehicles at *pose* (N, 4) of *length* (N,)."""
        steep = math.tan(options.steer_rad) / (WHEELBASE_PER_LENGTH * np.maximum(length, _LEAST_LENGTH_M))
        x, y, yaw, speed = np.ascontiguousarray(pose.T)
        return Vehicles(x, y, yaw, speed, steep, moved, options)

    def start(self) -> Motion:
        """Return their motion now."""
        return Motion(self.x, self.y, self.yaw, np.maximum(self.speed, 0.0))

    def features(self, motion: Motion) -> Array:
        """Return (N, 6): place, heading and speed relative to the present, as the decoder's node reads them."""
        out = blank((len(self.x), MOTION), self.x)
        east, north = _PLACE_SCALE * (motion.x - self.x), _PLACE_SCALE * (motion.y - self.y)
        cos, sin, turn = np.cos(self.yaw), np.sin(self.yaw), motion.yaw - self.yaw
        out[:, 0] = cos * east + sin * north
        out[:, 1] = cos * north - sin * east
        out[:, 2], out[:, 3] = np.cos(turn), np.sin(turn)
        out[:, 4], out[:, 5] = _SPEED_SCALE * motion.speed, _SPEED_SCALE * (motion.speed - self.speed)
        return out

    def features_back(self, grad: Array, motion: Motion) -> Motion:
        """Return the gradient of a motion for the gradient (N, 6) of its features."""
        cos, sin, turn = np.cos(self.yaw), np.sin(self.yaw), motion.yaw - self.yaw
        along, across, by_cos, by_sin, speed, change = grad.T
        return Motion(
            _PLACE_SCALE * (cos * along - sin * across),
            _PLACE_SCALE * (sin * along + cos * across),
            np.cos(turn) * by_sin - np.sin(turn) * by_cos,
            _SPEED_SCALE * (speed + change),
        )


@dataclass(frozen=True)
class Motion:
    """Where N vehicles are and how fast, or the gradients of that; each (N,)."""

    x: Array
    y: Array
    yaw: Array
    speed: Array

    def __add__(self, other: Motion) -> Motion:
        """Return the sums."""
        return Motion(self.x + other.x, self.y + other.y, self.yaw + other.yaw, self.speed + other.speed)


@dataclass(frozen=True)
class Driven:
    """A step and what its gradient needs; each (N,).

    Attributes:
        motion: after it.
        accel: of it.
        curvature: of it.
        before: the motion before.
        pressed: tanh of both controls.
        bound: limit of the acceleration that counts.
        limit: of the curvature.
        moving_s: how long until the vehicle stands or the step ends.
        travelled: distance along the arc.
        sinc: chord per distance.
    """

    motion: Motion
    accel: Array
    curvature: Array
    before: Motion
    pressed: tuple[Array, Array]
    bound: Array
    limit: Array
    moving_s: Array
    travelled: Array
    sinc: Array


def drive(cars: Vehicles, raw: Array, before: Motion) -> Driven:
    """Return the step that unbounded controls *raw* (N, 2) lead to."""
    dt, speed, options = MODEL_STEP_S, before.speed, cars.options
    push = raw[:, 0]
    bound = np.where(push > 0.0, options.accel_mps2, options.brake_mps2).astype(raw.dtype)
    pressed, turned = np.tanh(push / bound), np.tanh(raw[:, 1])
    limit = np.minimum(cars.steep, options.lateral_mps2 / np.square(np.maximum(speed, _LEAST_MPS)))
    accel, curvature = bound * pressed * cars.moved, limit * turned * cars.moved
    stops = speed / np.maximum(-accel, 1e-6)
    moving = np.where((accel < 0.0) & (stops < dt), stops, np.asarray(dt, raw.dtype))
    travelled = (speed + 0.5 * accel * moving) * moving
    half = 0.5 * curvature * travelled
    sinc = np.ones_like(half)
    np.divide(np.sin(half), half, out=sinc, where=half != 0.0)
    chord, heading = travelled * sinc, before.yaw + half
    motion = Motion(
        before.x + chord * np.cos(heading),
        before.y + chord * np.sin(heading),
        before.yaw + 2.0 * half,
        np.maximum(speed + accel * dt, 0.0),
    )
    return Driven(motion, accel, curvature, before, (pressed, turned), bound, limit, moving, travelled, sinc)


def drive_back(
    cars: Vehicles, done: Driven, grad: Motion, by_accel: Array, by_curvature: Array
) -> tuple[Array, Motion]:
    """Return the gradients of a step's controls (N, 2) and of the motion before it.

    Until a vehicle stands the time that takes does not matter for the distance: it moves no more at its end.

    Args:
        cars: the vehicles.
        done: the step.
        grad: gradients of the motion after it.
        by_accel: (N,) of its acceleration.
        by_curvature: (N,) of its curvature.
    """
    dt, speed = MODEL_STEP_S, done.before.speed
    half = 0.5 * done.curvature * done.travelled
    chord, heading = done.travelled * done.sinc, done.before.yaw + half
    cos, sin = np.cos(heading), np.sin(heading)
    by_chord = grad.x * cos + grad.y * sin
    by_heading = chord * (grad.y * cos - grad.x * sin)
    small = np.abs(half) < _SERIES
    series = -half / 3.0 * (1.0 - 0.1 * half * half)
    slope = np.where(small, series, (np.cos(half) - done.sinc) / np.where(small, 1.0, half))
    by_half = by_heading + 2.0 * grad.yaw + by_chord * done.travelled * slope
    by_way = by_chord * done.sinc + 0.5 * done.curvature * by_half
    goes = grad.speed * (speed + done.accel * dt >= 0.0)
    accel = by_accel + 0.5 * np.square(done.moving_s) * by_way + dt * goes
    curvature = by_curvature + 0.5 * done.travelled * by_half
    pressed, turned = done.pressed
    grip = (done.limit < cars.steep) & (speed >= _LEAST_MPS)
    tighter = np.where(grip, -2.0 * done.limit / np.maximum(speed, _LEAST_MPS), 0.0)
    raw = blank((len(speed), 2), speed)
    raw[:, 0] = cars.moved * accel * (1.0 - pressed * pressed)
    raw[:, 1] = cars.moved * curvature * done.limit * (1.0 - turned * turned)
    by_speed = done.moving_s * by_way + goes + cars.moved * curvature * turned * tighter
    return raw, Motion(grad.x, grad.y, grad.yaw + by_heading, by_speed)
