"""Drive plans with the bicycle model, to states every 0.1 s."""

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
_ALONG_GAIN = 1.0  # 1/s²: acceleration per metre of longitudinal error
_SPEED_GAIN = 2.0  # 1/s: acceleration per m/s of speed error

State = tuple[FloatArray, FloatArray, FloatArray]  # xy (…, 2), yaw (…,), speed (…,)


def drive_plan(
    state: State, plan: Controls | Trajectory, length_m: FloatArray, step_s: float, steps: int, limits: Limits
) -> State:
    """Return (steps, 2), (steps,), (steps,) states of one vehicle that drives *plan*.

    Arguments as in :func:`drive_controls`; a trajectory is followed as in :func:`track`.
    """
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
        controls: applied one after the other; the last one is held after the end.
        length_m: () vehicle length.
        step_s: spacing of the states.
        steps: number of states.
        limits: limits of the vehicle.

    Returns:
        (steps, 2), (steps,), (steps,).
    """
    index = np.minimum(
        (np.arange(steps) * step_s / controls.dt_s + 1e-9).astype(np.int64), len(controls.accel_mps2) - 1
    )
    steer = np.clip(controls.steer_rad[index], -limits.steer_rad, limits.steer_rad)
    curvature = np.tan(steer) / wheelbase_m(length_m)
    xy, yaw, speed = state
    states = []
    for k in range(steps):
        accel, bounded = clip_controls(speed, controls.accel_mps2[index[k]], curvature[k], length_m, limits)
        xy, yaw, speed = step(xy, yaw, speed, accel, bounded, step_s)
        states.append((xy, yaw, speed))
    return stacked(states)


def track(state: State, reference: State, length_m: FloatArray, step_s: float, limits: Limits) -> State:
    """Return the states of vehicles that follow *reference* as closely as the bicycle model allows.

    The controls are the reference's own acceleration and curvature (feed-forward) plus feedback of the pose error. A
    reference that a bicycle drove is reproduced exactly; any other one is followed within *limits*.

    Args:
        state: present centres (…, 2), yaws (…,), speeds (…,).
        reference: (…, T, 2), (…, T), (…, T) at now + step, now + 2 steps, …
        length_m: (…,) vehicle lengths.
        step_s: spacing of the reference.
        limits: limits of the vehicles.

    Returns:
        States of the same shape as *reference*.
    """
    previous = _shifted(state, reference)
    xy, yaw, speed = (np.empty(part.shape) for part in reference)
    by_step = [np.moveaxis(part, -1, 0) for part in _columns((xy, yaw, speed))]
    inputs = *_columns(previous), *_feed_forward(previous, reference, step_s)
    tightest = tightest_curvature_1pm(length_m, limits)[()]
    pose = state[0][..., 0][()], state[0][..., 1][()], state[1][()], state[2][()]
    instants = zip(*(np.moveaxis(part, -1, 0) for part in inputs), strict=True)
    for k, (*goal, goal_accel, goal_curvature) in enumerate(instants):
        accel, curvature = _controls(pose, goal, goal_accel, goal_curvature)
        accel, curvature = bounded_controls(pose[3], accel, curvature, tightest, limits)
        pose = advance(*pose, accel, curvature, step_s)
        by_step[0][k], by_step[1][k], by_step[2][k], by_step[3][k] = pose
    return xy, yaw, speed


def _columns(state: State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return x, y, yaw and speed of *state*."""
    return state[0][..., 0], state[0][..., 1], state[1], state[2]


def _shifted(state: State, reference: State) -> State:
    """Return the states of *reference* one step earlier, with *state* as the first."""
    return (
        np.concatenate((state[0][..., None, :], reference[0][..., :-1, :]), axis=-2),
        np.concatenate((state[1][..., None], reference[1][..., :-1]), axis=-1),
        np.concatenate((state[2][..., None], reference[2][..., :-1]), axis=-1),
    )


def _feed_forward(previous: State, reference: State, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Return accelerations and curvatures (…, T) of a reference between its *previous* and its present states."""
    driven = np.maximum(0.5 * (previous[2] + reference[2]) * dt_s, 1e-6)
    curvature = np.where(driven > 1e-3, wrap_angle(reference[1] - previous[1]) / driven, 0.0)
    return (reference[2] - previous[2]) / dt_s, curvature


def _controls(
    pose: Sequence[FloatArray], goal: Sequence[FloatArray], goal_accel: FloatArray, goal_curvature: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return acceleration and curvature that lead from *pose* towards the reference; all (…,).

    Poses are x, y, yaw and speed. *goal* is the reference's present pose; *goal_accel* and *goal_curvature* follow it.
    """
    x, y, yaw, speed = pose
    cos, sin = np.cos(yaw), np.sin(yaw)
    dx, dy = goal[0] - x, goal[1] - y
    along, left = cos * dx + sin * dy, cos * dy - sin * dx
    authority = np.minimum(1.0, speed / 2.0)  # a standing vehicle cannot correct laterally
    least_mps = np.maximum(speed, 1.0)
    feedback = authority * (_CROSS_GAIN * left + _HEADING_GAIN * wrapped(goal[2] - yaw)) / least_mps
    accel = goal_accel + _ALONG_GAIN * along + _SPEED_GAIN * (goal[3] - speed)
    return accel, goal_curvature + feedback


def densify(state: State, plan: State, dt_s: float, step_s: float, steps: int) -> State:
    """Return *plan* at every *step_s*, by cubic Hermite pieces that match speeds and headings.

    Args:
        state: present (…, 2), (…,), (…,), from which the first piece starts.
        plan: (…, T, 2), (…, T), (…, T) at now + dt, …
        dt_s: spacing of the plan.
        step_s: spacing of the result.
        steps: number of states; at most T · dt / step.
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
    va, vb = (_shortened(v, 3.0 * chord) for v in (va, vb))  # no overshoot of a short piece
    dense_xy = (
        (2 * u**3 - 3 * u**2 + 1) * a
        + (u**3 - 2 * u**2 + u) * va
        + (3 * u**2 - 2 * u**3) * b
        + (u**3 - u**2) * vb
    )
    share = u[..., 0]
    dense_yaw = wrap_angle(yaw[..., piece] + share * wrap_angle(yaw[..., piece + 1] - yaw[..., piece]))
    dense_speed = (1 - share) * speed[..., piece] + share * speed[..., piece + 1]
    return dense_xy, dense_yaw, dense_speed


def _shortened(vector: FloatArray, length: FloatArray) -> FloatArray:
    """Return *vector* (…, 2) with at most *length* (…, 1)."""
    norm = np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-9)
    return np.asarray(vector * np.minimum(1.0, length / norm))


def _velocity(yaw_rad: FloatArray, speed_mps: FloatArray) -> FloatArray:
    return np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), -1) * speed_mps[..., None]
