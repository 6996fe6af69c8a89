"""Complete plans of vehicles that appear or leave during the plan, and say when they are present."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.core.tracking import State

_MIN_DISTANCE_M = 10.0  # between centres, plus the distance that a follower needs to adapt its speed
_BRAKING_MPS2 = 4.0
_SAME_DIRECTION_COS = 0.5


def completed(tracks: Tracks, now: State) -> tuple[State, State]:
    """Return present states and a plan without gaps, so that vehicles can be driven along it.

    Before its first valid instant, and now if it is absent, a vehicle is on the straight line through its first state,
    at its first speed. After its last valid instant it continues likewise. :func:`presence` says when it is present.

    Args:
        tracks: (A, T) the plan.
        now: (A, 2), (A,), (A,) present states; NaN for absent vehicles.
    """
    state: State = now[0].copy(), now[1].copy(), now[2].copy()
    plan: State = tracks.xy_m.copy(), tracks.yaw_rad.copy(), tracks.speed_mps.copy()
    is_absent = ~np.isfinite(state[1])
    steps = np.arange(tracks.steps)
    for row in np.flatnonzero(is_absent | ~tracks.valid.all(axis=1)).tolist():
        valid = np.flatnonzero(tracks.valid[row])
        if not len(valid):
            _extrapolate(plan, row, steps, -1, tuple(np.nan_to_num(part[row]) for part in state), tracks.dt_s)
            continue
        for is_missing, at in ((steps < valid[0], valid[0]), (steps > valid[-1], valid[-1])):
            _extrapolate(
                plan, row, steps[is_missing], int(at), tuple(part[row, at] for part in plan), tracks.dt_s
            )
        if is_absent[row]:
            distance_m = (valid[0] + 1) * tracks.dt_s * plan[2][row, valid[0]]
            state[0][row] = plan[0][row, valid[0]] - distance_m * unit(plan[1][row, valid[0]])
            state[1][row], state[2][row] = plan[1][row, valid[0]], plan[2][row, valid[0]]
    return state, plan


def _extrapolate(
    plan: State, row: int, steps: FloatArray | np.ndarray, at: int, pose: tuple[FloatArray, ...], dt_s: float
) -> None:
    """Set instants *steps* of *row* to states on the straight line through *pose*, which holds at instant *at*."""
    xy, yaw, speed = pose
    offset_m = (steps - at) * dt_s * float(speed)
    plan[0][row, steps] = xy + offset_m[:, None] * unit(yaw)
    plan[1][row, steps], plan[2][row, steps] = yaw, speed


def presence(tracks: Tracks, absent: BoolArray, step_s: float, steps: int) -> BoolArray:
    """Return (A, steps) whether each vehicle is present, at every *step_s* from now on.

    A vehicle is present from its first to its last valid instant. If the plan's first instant is valid, vehicles that
    are present now also are so until then.

    Args:
        tracks: (A, T) the plan.
        absent: (A,) which vehicles are absent now.
        step_s: spacing wanted.
        steps: how many.
    """
    time_s = step_s * np.arange(1, steps + 1) + 1e-9
    present = np.zeros((tracks.agents, steps), dtype=np.bool_)
    for row in range(tracks.agents):
        valid_steps = np.flatnonzero(tracks.valid[row])
        if len(valid_steps):
            first_s, last_s = ((int(k) + 1) * tracks.dt_s for k in valid_steps[[0, -1]])
            begin_s = 0.0 if valid_steps[0] == 0 and not absent[row] else first_s
            end_s = np.inf if valid_steps[-1] == tracks.steps - 1 else last_s + 2e-9
            present[row] = (time_s >= begin_s) & (time_s <= end_s)
    return present


def have_room(new: State, others: State) -> BoolArray:
    """Return (N,) which new vehicles have room: no vehicle is close, and followers can still adapt their speed.

    Args:
        new: (N, 2), (N,), (N,) centres, headings and speeds of vehicles about to appear.
        others: (O, 2), (O,), (O,) of present vehicles; NaN if absent.
    """
    offset = new[0][:, None] - others[0]
    distance = np.linalg.norm(offset, axis=-1)
    is_follower = (offset * unit(others[1])).sum(axis=-1) > 0.0
    is_follower &= np.cos(new[1][:, None] - others[1]) > _SAME_DIRECTION_COS
    closing_mps = np.maximum(others[2] - new[2][:, None], 0.0) * is_follower
    braking_m = closing_mps + 0.5 * closing_mps**2 / _BRAKING_MPS2  # after a second to react
    return np.asarray(~(distance < _MIN_DISTANCE_M + braking_m).any(axis=1))  # NaN compares as False
