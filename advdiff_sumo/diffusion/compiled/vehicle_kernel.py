"""The decoder's vehicle with its gradient by hand: controls, arc, and what it sees of itself.

The same functions as ``models.tensor_bicycle`` and ``models.geometry``, equal up to rounding. A motion is x, y, yaw,
speed; a car is its motion now, to which others are relative, its largest curvature by steering, and 1 for vehicles or
0 for others, which keep their velocity; limits are the strongest acceleration, deceleration and lateral acceleration.
"""

from __future__ import annotations

import math

import numpy as np

from advdiff_sumo.core.bicycle import WHEELBASE_PER_LENGTH
from advdiff_sumo.diffusion.compiled.kernel import Array, kernel
from advdiff_sumo.models.model_options import MODEL_STEP_S, ModelOptions

CAR, MOTION, DONE = 6, 6, 8
"""Numbers of a car, of the features of its motion, and of what is kept of a step."""
_PLACE_SCALE, _SPEED_SCALE = 0.05, 0.1
_LEAST_MPS, _LEAST_LENGTH_M = 0.1, 0.5
_SERIES = 0.03  # below it the slope of sin x / x by its series, which loses no digits
_DT = MODEL_STEP_S


def cars_of(pose: Array, length: Array, moved: Array, options: ModelOptions) -> Array:
    """Return cars (N, 6) at *pose* (N, 4) of *length* (N,)."""
    out = np.empty((len(pose), CAR), pose.dtype)
    out[:, :4], out[:, 5] = pose, moved
    out[:, 4] = math.tan(options.steer_rad) / (WHEELBASE_PER_LENGTH * np.maximum(length, _LEAST_LENGTH_M))
    return out


def limits_of(options: ModelOptions, like: Array) -> Array:
    """Return limits (3,) of the precision of *like*."""
    return np.array((options.accel_mps2, options.brake_mps2, options.lateral_mps2), like.dtype)


@kernel
def features(car: Array, motion: Array, out: Array) -> None:
    """Set *out* (6,) to place, heading and speed relative to the present, as the decoder's node reads them."""
    east, north = _PLACE_SCALE * (motion[0] - car[0]), _PLACE_SCALE * (motion[1] - car[1])
    cos, sin, turn = math.cos(car[2]), math.sin(car[2]), motion[2] - car[2]
    out[0], out[1] = cos * east + sin * north, cos * north - sin * east
    out[2], out[3] = math.cos(turn), math.sin(turn)
    out[4], out[5] = _SPEED_SCALE * motion[3], _SPEED_SCALE * (motion[3] - car[3])


@kernel
def features_back(car: Array, done: Array, grad: Array, out: Array) -> None:
    """Add to the gradient *out* (4,) of a motion, kept in *done* (8,), for the gradient (6,) of its features."""
    cos, sin, turn = math.cos(car[2]), math.sin(car[2]), done[2] - car[2]
    out[0] += _PLACE_SCALE * (cos * grad[0] - sin * grad[1])
    out[1] += _PLACE_SCALE * (sin * grad[0] + cos * grad[1])
    out[2] += math.cos(turn) * grad[3] - math.sin(turn) * grad[2]
    out[3] += _SPEED_SCALE * (grad[4] + grad[5])


@kernel
def sinc(x: float) -> float:
    """Return sin x / x."""
    return 1.0 if x == 0.0 else math.sin(x) / x


@kernel
def moving_s(speed: float, accel: float) -> float:
    """Return how long until a vehicle stands or the step ends."""
    stops = speed / max(-accel, 1e-6)
    return stops if accel < 0.0 and stops < _DT else _DT


@kernel
def drive(car: Array, limits: Array, raw: Array, motion: Array, done: Array) -> None:
    """Move *motion* (4,) on by the step that unbounded controls *raw* (2,) lead to.

    Args:
        car: (6,).
        limits: (3,).
        raw: (2,) what the network says.
        motion: (4,) before; afterwards, after.
        done: (8,) to be written: the motion before, acceleration, curvature, and tanh of both controls.
    """
    bound = limits[0] if raw[0] > 0.0 else limits[1]
    pressed, turned = math.tanh(raw[0] / bound), math.tanh(raw[1])
    speed = motion[3]
    limit = min(car[4], limits[2] / max(speed, _LEAST_MPS) ** 2)
    accel, curvature = bound * pressed * car[5], limit * turned * car[5]
    moving = moving_s(speed, accel)
    travelled = (speed + 0.5 * accel * moving) * moving
    half = 0.5 * curvature * travelled
    chord, heading = travelled * sinc(half), motion[2] + half
    for i in range(4):
        done[i] = motion[i]
    done[4], done[5], done[6], done[7] = accel, curvature, pressed, turned
    motion[0] += chord * math.cos(heading)
    motion[1] += chord * math.sin(heading)
    motion[2] += 2.0 * half
    motion[3] = max(speed + accel * _DT, 0.0)


@kernel
def drive_back(car: Array, limits: Array, done: Array, grad: Array, controls: Array, raw: Array) -> None:
    """Turn the gradient of the motion after a step into that of the one before it, and write that of *raw* (2,).

    Until a vehicle stands the time that takes does not matter for the distance: it moves no more at its end.

    Args:
        car: (6,).
        limits: (3,).
        done: (8,) of the step.
        grad: (4,) gradient of the motion after; afterwards, of the one before.
        controls: (2,) gradients of acceleration and curvature.
        raw: (2,) to be written: the gradient of the unbounded controls.
    """
    yaw, speed, accel, curvature = done[2], done[3], done[4], done[5]
    pressed, turned, moved = done[6], done[7], car[5]
    moving = moving_s(speed, accel)
    travelled = (speed + 0.5 * accel * moving) * moving
    half = 0.5 * curvature * travelled
    share, heading = sinc(half), yaw + half
    cos, sin = math.cos(heading), math.sin(heading)
    by_chord = grad[0] * cos + grad[1] * sin
    by_heading = travelled * share * (grad[1] * cos - grad[0] * sin)
    series = -half / 3.0 * (1.0 - 0.1 * half * half)
    slope = series if abs(half) < _SERIES else (math.cos(half) - share) / half
    by_half = by_heading + 2.0 * grad[2] + by_chord * travelled * slope
    by_way = by_chord * share + 0.5 * curvature * by_half
    goes = grad[3] if speed + accel * _DT >= 0.0 else 0.0
    by_accel = controls[0] + 0.5 * moving**2 * by_way + _DT * goes
    by_curvature = controls[1] + 0.5 * travelled * by_half
    grip = limits[2] / max(speed, _LEAST_MPS) ** 2
    limit = min(car[4], grip)
    tighter = -2.0 * limit / speed if grip < car[4] and speed >= _LEAST_MPS else 0.0
    raw[0] = moved * by_accel * (1.0 - pressed * pressed)
    raw[1] = moved * by_curvature * limit * (1.0 - turned * turned)
    grad[2] += by_heading
    grad[3] = moving * by_way + goes + moved * by_curvature * turned * tighter
