"""Keeps a follower of the target so far behind that it can stop if the target brakes in full.

On a motorway it is too late to brake when predicted boxes overlap within the next seconds: a prediction does not show
that the target will brake, nor for how long. The safe speed is that of Gipps (1981,
doi:10.1016/0191-2615(81)90037-0).
"""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.metrics.reference.driver_models import FULL_BRAKE_MPS2
from advdiff_sumo.traffic.planning.braking import GAP_M, SIDE_M
from advdiff_sumo.traffic.planning.futures import Futures
from advdiff_sumo.traffic.planning.planned_paths import PlannedPaths, drive_along

OWN_BRAKE_MPS2 = 7.0
"""Deceleration with which the follower must be able to stop, from the next plan on."""
_SAME_DIRECTION_COS = 0.7
_SHORTEST_PATH_M = 0.1
"""A plan that moves less than this along both axes is not checked."""
_BRAKING_STEPS = 2
"""Instants for which the follower brakes; afterwards it keeps its speed until it is planned anew."""


def keep_back(futures: Futures, rows: BoolArray, target: int, ladder_mps2: tuple[float, ...]) -> BoolArray:
    """Let followers of *target* among *rows* (N,) brake as mildly as suffices, in place.

    Braking suffices if the follower can drive on for one step, then brake with ``OWN_BRAKE_MPS2``, and stop behind a
    target that brakes with ``FULL_BRAKE_MPS2`` from now on.

    Args:
        futures: plans and predictions of N road users.
        rows: whose plans may be changed.
        target: row of the target.
        ladder_mps2: decelerations to try, mildest first; the last one is taken if none suffices.

    Returns:
        (N,) whether the vehicle brakes.
    """
    braked = np.zeros(futures.agents, dtype=np.bool_)
    may_follow = rows & _is_near_path(futures, target)
    if not may_follow.any():
        return braked
    paths = PlannedPaths(futures)
    for row in np.flatnonzero(may_follow).tolist():
        lead = _lead_gap(futures, row, target)
        if lead is None:
            continue
        gap, lead_speed = lead
        driven = _braking_profiles(futures, row, ladder_mps2)  # (C, T)
        speed = 2.0 * driven[:, 0] / futures.dt_s - futures.speed_mps[row, 0]
        stop_distance = driven[:, 0] + 0.5 * np.maximum(speed, 0.0) ** 2 / OWN_BRAKE_MPS2
        suffices = stop_distance + GAP_M <= gap + 0.5 * lead_speed**2 / FULL_BRAKE_MPS2
        chosen = int(suffices.argmax()) if suffices.any() else len(driven) - 1
        if chosen > 0:
            drive_along(futures, paths, row, driven[chosen])
            braked[row] = True
    return braked


def _is_near_path(futures: Futures, target: int) -> BoolArray:
    """Return (N,) whether a path moves at all and its bounding box, enlarged, holds the rear of the target."""
    low, high = futures.xy_m.min(axis=1), futures.xy_m.max(axis=1)
    width = futures.size_m[:, 1] + futures.size_m[target, 1]
    margin = (0.5 * (futures.size_m[:, 0] + width) + SIDE_M)[:, None]
    rear = _rear(futures, target)
    within = ((low - margin <= rear) & (rear <= high + margin)).all(axis=1)
    return np.asarray(within & ((high - low).max(axis=1) >= _SHORTEST_PATH_M))


def _rear(futures: Futures, row: int) -> FloatArray:
    """Return (2,) the middle of the rear of *row*."""
    heading = unit(futures.yaw_rad[row, 0])
    return np.asarray(futures.xy_m[row, 0] - 0.5 * futures.size_m[row, 0] * heading)


def _lead_gap(futures: Futures, row: int, target: int) -> tuple[float, float] | None:
    """Return the bumper-to-bumper gap from *row* to *target* along its planned path, and the target's speed along it.

    None if the target is not ahead on the path, is beside it, or does not drive in its direction.
    """
    path = Polyline.of(futures.xy_m[row])
    yaw = float(futures.yaw_rad[target, 0])
    s, left = (float(value) for value in path.project(_rear(futures, target), extrapolate=True))
    cos = float(np.cos(yaw - float(path.at(float(np.clip(s, 0.0, path.length_m)))[1])))
    gap = s - 0.5 * float(futures.size_m[row, 0])
    farthest_aside = 0.5 * float(futures.size_m[[row, target], 1].sum()) + SIDE_M
    if abs(left) > farthest_aside or cos < _SAME_DIRECTION_COS or not 0.0 < gap < path.length_m:
        return None
    return gap, max(float(futures.speed_mps[target, 0]) * cos, 0.0)


def _braking_profiles(futures: Futures, row: int, ladder_mps2: tuple[float, ...]) -> FloatArray:
    """Return distances driven (C, T): as planned, then for each deceleration, at most as planned."""
    planned = futures.travelled_m()[row, 1:]
    speed, dt = float(futures.speed_mps[row, 0]), futures.dt_s
    steps = np.arange(futures.steps + 1)
    speeds = np.maximum(speed - np.array(ladder_mps2)[:, None] * dt * np.minimum(steps, _BRAKING_STEPS), 0.0)
    braked = np.cumsum(0.5 * dt * (speeds[:, 1:] + speeds[:, :-1]), axis=1)
    return np.vstack((planned, np.minimum(planned, braked)))
