"""Predicts pedestrians and cyclists without a plan: they keep their velocity, whatever their heading."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.traffic.planning.futures import Futures

PEOPLE = (AgentClass.PEDESTRIAN, AgentClass.BICYCLE)
"""Road users without a car body."""
PEOPLE_SIDE_M = 0.3
"""Clearance to them on each side."""
_LOOK_BACK_S = 1.0


def velocities(history: Tracks) -> FloatArray:
    """Return (A, 2) mean velocities over the last second; for a shorter history, over what there is.

    Without any past the velocity is the present speed along the heading.
    """
    xy, valid = history.xy_m, history.valid
    steps = min(round(_LOOK_BACK_S / history.dt_s), history.steps - 1)
    yaw, speed = history.yaw_rad[:, -1], history.speed_mps[:, -1]
    velocity = speed[:, None] * np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
    for back in range(1, steps + 1):
        known = valid[:, -1 - back : history.steps].all(axis=1)
        velocity[known] = (xy[known, -1] - xy[known, -1 - back]) / (back * history.dt_s)
    return np.asarray(velocity)


def go_straight(futures: Futures, rows: BoolArray, velocity_mps: FloatArray) -> None:
    """Let *rows* (N,) keep their velocities (N, 2) and headings, in place."""
    time = futures.dt_s * np.arange(1, futures.steps + 1)
    futures.xy_m[rows, 1:] = futures.xy_m[rows, :1] + time[:, None] * velocity_mps[rows, None]
    futures.yaw_rad[rows, 1:] = futures.yaw_rad[rows, :1]
    futures.speed_mps[rows, 1:] = np.linalg.norm(velocity_mps[rows], axis=-1)[:, None]
