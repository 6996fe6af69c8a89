"""Vehicles of a plan that are not there all the time: who comes in, and who leaves."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.core.tracking import State

_APART_M, _STOPS_MPS2, _SAME_WAY = 10.0, 4.0, 0.5


def completed(tracks: Tracks, now: State) -> tuple[State, State]:
    """Return present states and a plan that lack nothing, so that they can be driven.

    Before its first valid instant, and at present where it has no state yet, a vehicle comes along its first heading
    at its first speed; behind its last valid instant it goes on likewise. ``presence`` says when it is there.

    Args:
        tracks: (A, T) the plan.
        now: (A, 2), (A,), (A,) present states; NaN for who is not there yet.
    """
    state: State = now[0].copy(), now[1].copy(), now[2].copy()
    plan: State = tracks.xy_m.copy(), tracks.yaw_rad.copy(), tracks.speed_mps.copy()
    absent = ~np.isfinite(state[1])
    steps = np.arange(tracks.steps)
    for row in np.flatnonzero(absent | ~tracks.valid.all(axis=1)).tolist():
        known = np.flatnonzero(tracks.valid[row])
        if not len(known):
            _coast(plan, row, steps, -1, tuple(np.nan_to_num(part[row]) for part in state), tracks.dt_s)
            continue
        for lacking, at in ((steps < known[0], known[0]), (steps > known[-1], known[-1])):
            _coast(plan, row, steps[lacking], int(at), tuple(part[row, at] for part in plan), tracks.dt_s)
        if absent[row]:
            back = (known[0] + 1) * tracks.dt_s * plan[2][row, known[0]]
            state[0][row] = plan[0][row, known[0]] - back * unit(plan[1][row, known[0]])
            state[1][row], state[2][row] = plan[1][row, known[0]], plan[2][row, known[0]]
    return state, plan


def _coast(
    plan: State, row: int, steps: FloatArray | np.ndarray, at: int, pose: tuple[FloatArray, ...], dt_s: float
) -> None:
    """Write to instants *steps* of *row* what lies on the straight line through *pose*, which is at instant *at*."""
    xy, yaw, speed = pose
    away = (steps - at) * dt_s * float(speed)
    plan[0][row, steps] = xy + away[:, None] * unit(yaw)
    plan[1][row, steps], plan[2][row, steps] = yaw, speed


def presence(tracks: Tracks, absent: BoolArray, step_s: float, steps: int) -> BoolArray:
    """Return (A, steps) whether each vehicle is there at every *step_s* from now on.

    It is there from its first to its last valid instant; between now and the plan's first instant, where that is
    valid, only who is there already is.

    Args:
        tracks: (A, T) the plan.
        absent: (A,) who is not there now.
        step_s: spacing wanted.
        steps: how many.
    """
    time = step_s * np.arange(1, steps + 1) + 1e-9
    out = np.zeros((tracks.agents, steps), dtype=np.bool_)
    for row in range(tracks.agents):
        known = np.flatnonzero(tracks.valid[row])
        if len(known):
            first, last = ((int(k) + 1) * tracks.dt_s for k in known[[0, -1]])
            begins = 0.0 if known[0] == 0 and not absent[row] else first
            ends = np.inf if known[-1] == tracks.steps - 1 else last + 2e-9
            out[row] = (time >= begins) & (time <= ends)
    return out


def have_room(new: State, others: State) -> BoolArray:
    """Return (N,) which newcomers have room: nobody is close, and who comes from behind can still stop.

    Args:
        new: (N, 2), (N,), (N,) centres, headings and speeds of those about to come in.
        others: (O, 2), (O,), (O,) of who is there; NaN for who is not.
    """
    offset = new[0][:, None] - others[0]
    apart = np.linalg.norm(offset, axis=-1)
    follows = (offset * unit(others[1])).sum(axis=-1) > 0.0
    follows &= np.cos(new[1][:, None] - others[1]) > _SAME_WAY
    closing = np.maximum(others[2] - new[2][:, None], 0.0) * follows
    stops = closing + 0.5 * closing**2 / _STOPS_MPS2  # after a second to react
    return np.asarray(~(apart < _APART_M + stops).any(axis=1))  # NaN compares as False
