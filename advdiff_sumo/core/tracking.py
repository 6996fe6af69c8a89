"""From plans to states every 0.1 s, through the bicycle model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import (
    Limits,
    advance,
    bounded_controls,
    clip_controls,
    stacked,
    step,
    tightest_curvature_1pm,
    wheelbase_m,
)
from advdiff_sumo.core.frames import wrap_angle, wrapped
from advdiff_sumo.core.plan import Controls, Trajectory

_CROSS_GAIN = 0.6  # 1/(m s): curvature × speed per metre of lateral error
_HEADING_GAIN = 2.4  # 1/s: curvature × speed per radian of heading error
_ALONG_GAIN, _SPEED_GAIN = 1.0, 2.0  # 1/s², 1/s

State = tuple[FloatArray, FloatArray, FloatArray]  # xy (…, 2), yaw (…,), speed (…,)


def drive_plan(
    state: State, plan: Controls | Trajectory, length_m: FloatArray, step_s: float, steps: int, limits: Limits
) -> State:
    """Return (steps, 2), (steps,), (steps,) states of one vehicle under *plan*; see the two functions below."""
    if isinstance(plan, Controls):
        return drive_controls(state, plan, length_m, step_s, steps, limits)
    reference = (plan.xy_m, plan.yaw_rad, plan.speed_mps)
    if abs(plan.dt_s - step_s) > 1e-9:
        reference = densify(state, reference, plan.dt_s, step_s, steps)
    return track(state, tuple(part[:steps] for part in reference), length_m, step_s, limits)  # type: ignore[arg-type] # a State: three parts


def drive_controls(
    state: State, controls: Controls, length_m: FloatArray, step_s: float, steps: int, limits: Limits
) -> State:
    """Return states after each of *steps* of *step_s* under *controls*, within *limits*.

    Args:
        state: present centre (2,), yaw () and speed ().
        controls: held in turn; the last one holds on when they run out.
        length_m: () vehicle length.
        step_s: spacing of the states.
        steps: how many.
        limits: what the vehicle can do.

    Returns:
        (steps, 2), (steps,), (steps,).
    """
    held = np.minimum(
        (np.arange(steps) * step_s / controls.dt_s + 1e-9).astype(np.int64), len(controls.accel_mps2) - 1
    )
    curvature = np.tan(np.clip(controls.steer_rad[held], -limits.steer_rad, limits.steer_rad)) / wheelbase_m(
        length_m
    )
    xy, yaw, speed = state
    out = []
    for k in range(steps):
        accel, bend = clip_controls(speed, controls.accel_mps2[held[k]], curvature[k], length_m, limits)
        xy, yaw, speed = step(xy, yaw, speed, accel, bend, step_s)
        out.append((xy, yaw, speed))
    return stacked(out)


def track(state: State, reference: State, length_m: FloatArray, step_s: float, limits: Limits) -> State:
    """Follow *reference* as closely as the bicycle model allows.

    Feed-forward of the reference's own acceleration and curvature plus feedback of the pose error, so a
    reference that a bicycle drove is reproduced exactly and any other one is followed within *limits*.

    Args:
        state: present centres (…, 2), yaws (…,), speeds (…,).
        reference: (…, T, 2), (…, T), (…, T) at now + step, now + 2 steps, …
        length_m: (…,) vehicle lengths.
        step_s: spacing of the reference.
        limits: what the vehicles can do.

    Returns:
        States of the same shape as *reference*.
    """
    before = _before(state, reference)
    xy, yaw, speed = (np.empty(part.shape) for part in reference)
    x, y, *rest = (np.moveaxis(part, -1, 0) for part in (xy[..., 0], xy[..., 1], yaw, speed))
    given = *_columns(before), *_feed_forward(before, reference, step_s)
    tightest = tightest_curvature_1pm(length_m, limits)[()]
    pose = state[0][..., 0][()], state[0][..., 1][()], state[1][()], state[2][()]
    for k, (*last, push, turn) in enumerate(zip(*(np.moveaxis(part, -1, 0) for part in given), strict=True)):
        accel, bend = _controls(pose, last, push, turn)
        accel, bend = bounded_controls(pose[3], accel, bend, tightest, limits)
        pose = advance(*pose, accel, bend, step_s)
        x[k], y[k], rest[0][k], rest[1][k] = pose
    return xy, yaw, speed


def _columns(state: State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return x, y, yaw and speed of *state*."""
    return state[0][..., 0], state[0][..., 1], state[1], state[2]


def _before(state: State, reference: State) -> State:
    """Return what *reference* is one step before each of its instants: *state* at first."""
    return (
        np.concatenate((state[0][..., None, :], reference[0][..., :-1, :]), axis=-2),
        np.concatenate((state[1][..., None], reference[1][..., :-1]), axis=-1),
        np.concatenate((state[2][..., None], reference[2][..., :-1]), axis=-1),
    )


def _feed_forward(last: State, goal: State, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the accelerations and curvatures (…, T) with which a reference itself gets from *last* to *goal*."""
    driven = np.maximum(0.5 * (last[2] + goal[2]) * dt_s, 1e-6)
    bend = np.where(driven > 1e-3, wrap_angle(goal[1] - last[1]) / driven, 0.0)
    return (goal[2] - last[2]) / dt_s, bend


def _controls(
    pose: Sequence[FloatArray], last: Sequence[FloatArray], push: FloatArray, turn: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return acceleration and curvature that lead from *pose* towards where the reference goes; all (…,).

    It was to be at *last* by now, and goes on with the acceleration *push* and the curvature *turn*.
    """
    x, y, yaw, speed = pose
    cos, sin = np.cos(yaw), np.sin(yaw)
    east, north = last[0] - x, last[1] - y
    along, left = cos * east + sin * north, cos * north - sin * east
    near = np.minimum(1.0, speed / 2.0)  # a standing vehicle cannot correct sideways
    pace = np.maximum(speed, 1.0)
    bend = turn + near * (_CROSS_GAIN * left + _HEADING_GAIN * wrapped(last[2] - yaw)) / pace
    accel = push + _ALONG_GAIN * along + _SPEED_GAIN * (last[3] - speed)
    return accel, bend


def densify(state: State, plan: State, dt_s: float, step_s: float, steps: int) -> State:
    """Return *plan* at every *step_s*, by cubic Hermite pieces that respect speeds and headings.

    Args:
        state: present (…, 2), (…,), (…,), which begins the first piece.
        plan: (…, T, 2), (…, T), (…, T) at now + dt, …
        dt_s: spacing of the plan.
        step_s: spacing wanted.
        steps: how many; at most T · dt / step.
    """
    xy = np.concatenate((state[0][..., None, :], plan[0]), axis=-2)
    yaw = np.concatenate((state[1][..., None], plan[1]), axis=-1)
    speed = np.concatenate((state[2][..., None], plan[2]), axis=-1)
    time = np.arange(1, steps + 1) * step_s / dt_s
    piece = np.minimum((time - 1e-9).astype(np.int64), plan[1].shape[-1] - 1)
    u = (time - piece)[..., None]
    a, b = xy[..., piece, :], xy[..., piece + 1, :]
    chord = np.linalg.norm(b - a, axis=-1, keepdims=True)
    va, vb = (_velocity(yaw[..., piece + i], speed[..., piece + i]) * dt_s for i in (0, 1))
    va, vb = (_at_most(v, 3.0 * chord) for v in (va, vb))  # no overshoot of a short piece
    where = (
        (2 * u**3 - 3 * u**2 + 1) * a
        + (u**3 - 2 * u**2 + u) * va
        + (3 * u**2 - 2 * u**3) * b
        + (u**3 - u**2) * vb
    )
    share = u[..., 0]
    turned = wrap_angle(yaw[..., piece] + share * wrap_angle(yaw[..., piece + 1] - yaw[..., piece]))
    pace = (1 - share) * speed[..., piece] + share * speed[..., piece + 1]
    return where, turned, pace


def _at_most(vector: FloatArray, length: FloatArray) -> FloatArray:
    norm = np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-9)
    return np.asarray(vector * np.minimum(1.0, length / norm))


def _velocity(yaw_rad: FloatArray, speed_mps: FloatArray) -> FloatArray:
    return np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), -1) * speed_mps[..., None]
