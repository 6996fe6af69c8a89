"""Who follows the target keeps so far behind that it can stop should that brake in full: a safe speed.

Looking for boxes that meet in the next seconds is too late for it on a motorway: predictions do not say that a target
brakes before it does, nor for how long. The speed is that of Gipps (1981, doi:10.1016/0191-2615(81)90037-0).
"""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.metrics.reference.driver_models import FULL_BRAKE_MPS2
from advdiff_sumo.traffic.planning.braking import GAP_M, SIDE_M
from advdiff_sumo.traffic.planning.futures import Futures
from advdiff_sumo.traffic.planning.planned_paths import PlannedPaths, speeds_of_strides

OWN_BRAKE_MPS2 = 7.0
"""Braking from the next plan on with which it has to be able to stop."""
_SAME_WAY = 0.7
_CREEPS_M = 0.1
"""Who plans to drive less than this along either axis does not get to anybody."""
_EASES_STEPS = 2
"""Instants for which it brakes, unless it is planned anew; later it goes on at the speed that it has then."""


def keep_back(futures: Futures, rows: BoolArray, target: int, ladder_mps2: tuple[float, ...]) -> BoolArray:
    """Let those of *rows* (N,) that follow *target* brake, as mildly as suffices, in place.

    It suffices that it drives on for one step, then brakes with ``OWN_BRAKE_MPS2``, and stops behind a target that
    brakes with ``FULL_BRAKE_MPS2`` from now on.

    Args:
        futures: plans and predictions of N road users.
        rows: whose plans may be changed.
        target: row of the target.
        ladder_mps2: decelerations that are tried, mildest first; where none suffices it is the last.

    Returns:
        (N,) who brakes.
    """
    out = np.zeros(futures.agents, dtype=np.bool_)
    may_follow = rows & _near_plan(futures, target)
    if not may_follow.any():
        return out
    path = PlannedPaths(futures)
    for row in np.flatnonzero(may_follow).tolist():
        place = _place_ahead(futures, row, target)
        if place is None:
            continue
        driven = _driven(futures, row, ladder_mps2)  # (C, T)
        speed = 2.0 * driven[:, 0] / futures.dt_s - futures.speed_mps[row, 0]
        stops = driven[:, 0] + 0.5 * np.maximum(speed, 0.0) ** 2 / OWN_BRAKE_MPS2
        enough = stops + GAP_M <= place[0] + 0.5 * place[1] ** 2 / FULL_BRAKE_MPS2
        best = int(enough.argmax()) if enough.any() else len(driven) - 1
        if best > 0:
            xy, yaw = path.at(row, driven[best])
            futures.put(row, xy, yaw, speeds_of_strides(np.diff(driven[best], prepend=0.0), futures.dt_s))
            out[row] = True
    return out


def _near_plan(futures: Futures, target: int) -> BoolArray:
    """Return (N,) whose path goes anywhere and has the rear of the target within its bounding box, with room."""
    low, high = futures.xy_m.min(axis=1), futures.xy_m.max(axis=1)
    width = futures.size_m[:, 1] + futures.size_m[target, 1]
    room = (0.5 * (futures.size_m[:, 0] + width) + SIDE_M)[:, None]
    rear = _rear(futures, target)
    within = ((low - room <= rear) & (rear <= high + room)).all(axis=1)
    return np.asarray(within & ((high - low).max(axis=1) >= _CREEPS_M))


def _rear(futures: Futures, row: int) -> FloatArray:
    """Return (2,) the middle of the rear of *row*."""
    heading = unit(futures.yaw_rad[row, 0])
    return np.asarray(futures.xy_m[row, 0] - 0.5 * futures.size_m[row, 0] * heading)


def _place_ahead(futures: Futures, row: int, target: int) -> tuple[float, float] | None:
    """Return the bumper gap from *row* to *target* on its planned path, and the speed of that along it.

    None where the target is not on it, is beside, or comes the other way.
    """
    line = Polyline.of(futures.xy_m[row])
    yaw = float(futures.yaw_rad[target, 0])
    s, left = (float(value) for value in line.project(_rear(futures, target), extrapolate=True))
    cos = float(np.cos(yaw - float(line.at(float(np.clip(s, 0.0, line.length_m)))[1])))
    gap = s - 0.5 * float(futures.size_m[row, 0])
    aside = 0.5 * float(futures.size_m[[row, target], 1].sum()) + SIDE_M
    if abs(left) > aside or cos < _SAME_WAY or not 0.0 < gap < line.length_m:
        return None
    return gap, max(float(futures.speed_mps[target, 0]) * cos, 0.0)


def _driven(futures: Futures, row: int, ladder_mps2: tuple[float, ...]) -> FloatArray:
    """Return distances driven (C, T): by the plan as it is, then by the plan or each deceleration, what is less."""
    planned = futures.travelled_m()[row, 1:]
    speed, dt = float(futures.speed_mps[row, 0]), futures.dt_s
    steps = np.arange(futures.steps + 1)
    speeds = np.maximum(speed - np.array(ladder_mps2)[:, None] * dt * np.minimum(steps, _EASES_STEPS), 0.0)
    eased = np.cumsum(0.5 * dt * (speeds[:, 1:] + speeds[:, :-1]), axis=1)
    return np.vstack((planned, np.minimum(planned, eased)))
