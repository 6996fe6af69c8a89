"""One vehicle that follows a reference: ``tracking.track`` in plain numbers, a tenth of the work of arrays of one.

To the last digit what :func:`~advdiff_sumo.core.tracking.track` gives for a vehicle alone; the laws stand there and in
:mod:`~advdiff_sumo.core.bicycle`, and a test holds both to each other.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import WHEELBASE_PER_LENGTH, Limits
from advdiff_sumo.core.tracking import ALONG_GAIN, CROSS_GAIN, HEADING_GAIN, SPEED_GAIN

Pose: TypeAlias = tuple[float, float, float, float]
"""x and y in metres, heading in rad and speed in m/s, world frame."""

_EPS = float(np.finfo(np.float64).eps)


def track_one(
    state: Pose,
    reference: tuple[FloatArray, FloatArray, FloatArray],
    length_m: float,
    step_s: float,
    limits: Limits,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions (T, 2), headings (T,) and speeds (T,) of a vehicle that follows *reference*.

    Args:
        state: now.
        reference: positions (T, 2), headings (T,) and speeds (T,) at now + step, now + 2 steps, …; finite.
        length_m: of the vehicle.
        step_s: spacing of the reference.
        limits: what the vehicle can do.
    """
    tightest = float(np.tan(limits.steer_rad)) / (WHEELBASE_PER_LENGTH * length_m)
    columns = (reference[0][:, 0], reference[0][:, 1], reference[1], reference[2])
    goals: list[Pose] = list(zip(*(column.tolist() for column in columns), strict=True))
    at, last, out = state, state, list[Pose]()
    for goal in goals:
        accel, bend = _controls(at, last, goal, step_s)
        at, last = _stepped(at, *_within(at[3], accel, bend, tightest, limits), step_s), goal
        out.append(at)
    states = np.array(out)
    return states[:, :2].copy(), states[:, 2].copy(), states[:, 3].copy()


def _controls(at: Pose, last: Pose, goal: Pose, dt_s: float) -> tuple[float, float]:
    """Return acceleration and curvature that lead from *at* towards *goal*, by way of the goal before."""
    x, y, yaw, speed = at
    cos, sin = float(np.cos(yaw)), float(np.sin(yaw))
    dx, dy = last[0] - x, last[1] - y
    step_m = max(0.5 * (last[3] + goal[3]) * dt_s, 1e-6)
    feed = _wrapped(goal[2] - last[2]) / step_m if step_m > 1e-3 else 0.0
    back = CROSS_GAIN * (cos * dy - sin * dx) + HEADING_GAIN * _wrapped(last[2] - yaw)
    bend = feed + min(1.0, speed / 2.0) * back / max(speed, 1.0)
    along = ALONG_GAIN * (cos * dx + sin * dy)
    return (goal[3] - last[3]) / dt_s + along + SPEED_GAIN * (last[3] - speed), bend


def _within(
    speed: float, accel: float, bend: float, tightest_1pm: float, limits: Limits
) -> tuple[float, float]:
    accel = min(max(accel, -limits.brake_mps2), limits.accel_mps2)
    if speed >= limits.speed_mps:
        accel = min(accel, 0.0)
    bound = min(tightest_1pm, limits.lateral_mps2 / max(speed, 0.1) ** 2)
    return accel, min(max(bend, -bound), bound)


def _stepped(at: Pose, accel: float, bend: float, dt_s: float) -> Pose:
    """Return *at* after *dt_s* along an arc; it stops at zero speed."""
    x, y, yaw, speed = at
    stop_s = speed / max(-accel, 1e-9) if accel < 0.0 else math.inf
    moving_s = min(max(stop_s, 0.0), dt_s)
    travelled = speed * moving_s + 0.5 * accel * moving_s**2
    turn = bend * travelled
    half = 0.5 * turn
    angle = math.pi * (half / math.pi) or _EPS  # as in numpy.sinc
    chord = travelled * (float(np.sin(angle)) / angle)
    heading = yaw + half
    moved = x + chord * float(np.cos(heading)), y + chord * float(np.sin(heading))
    return *moved, _wrapped(yaw + turn), 0.0 if stop_s <= dt_s else speed + accel * dt_s


def _wrapped(angle_rad: float) -> float:
    """Return *angle_rad* in (−π, π]."""
    return -((-angle_rad + math.pi) % (2.0 * math.pi) - math.pi)
