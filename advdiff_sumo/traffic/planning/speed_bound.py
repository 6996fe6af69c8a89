"""Slows planned vehicles along their own paths to a share of the speed limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.traffic.planning.futures import Futures
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.planning.planned_paths import PlannedPaths

EASE_MPS2 = 2.5
"""Deceleration with which a lower limit is met, and a speed over the limit now is taken back."""
NO_LANE_MPS = 5.0
"""Who is on no lane drives no faster than this, or than it does now."""
_OVER_MPS = 0.05


def bound_speeds(
    futures: Futures,
    rows: IntArray,
    lanes: Sequence[LaneAhead | None],
    limits_mps: Mapping[str, float],
    share: FloatArray,
) -> None:
    """Let *rows* (V,) drive no faster than their *share* of the limit of the lane that they are on, in place.

    Args:
        futures: plans of N road users.
        rows: whose plans are bounded.
        lanes: N lanes that each would follow.
        limits_mps: lane → its legal limit.
        share: (N,) highest share of the limit.
    """
    driven, fastest = futures.travelled_m(), futures.speed_mps[:, 1:].max(axis=1).tolist()
    eased = futures.speed_mps[:, :1] - EASE_MPS2 * futures.dt_s * np.arange(1, futures.steps + 1)
    paths: PlannedPaths | None = None
    for row in rows.tolist():
        if fastest[row] <= share[row] * _lowest_mps(lanes[row], limits_mps):
            continue
        begin, bound = sections(lanes[row], limits_mps, float(share[row]))
        allowed = np.maximum(allowed_mps(begin, bound, driven[row, 1:]), eased[row])
        if (futures.speed_mps[row, 1:] <= allowed + _OVER_MPS).all():
            continue
        paths = paths or PlannedPaths(futures.copy())
        _slow(futures, paths, row, begin, bound)


def _lowest_mps(lane: LaneAhead | None, limits_mps: Mapping[str, float]) -> float:
    return 0.0 if lane is None else min(limits_mps[part.id] for part in lane.lanes)


def sections(
    lane: LaneAhead | None, limits_mps: Mapping[str, float], share: float
) -> tuple[FloatArray, FloatArray]:
    """Return where (K,) the lanes ahead begin, from the vehicle on, and *share* of their limits (K,)."""
    if lane is None:
        return np.zeros(1), np.full(1, NO_LANE_MPS)
    ends = np.cumsum([part.length_m for part in lane.lanes]) - lane.s_m
    return np.append(0.0, ends[:-1]), share * np.array([limits_mps[part.id] for part in lane.lanes])


def allowed_mps(begin_m: FloatArray, bound_mps: FloatArray, s_m: FloatArray) -> FloatArray:
    """Return (T,) the highest speeds at *s_m* (T,) that keep the bounds (K,) of sections from *begin_m* (K,) on."""
    ahead = begin_m - s_m[:, None]
    here = np.maximum(np.searchsorted(begin_m, s_m, side="right") - 1, 0)
    bound = np.sqrt(bound_mps**2 + 2.0 * EASE_MPS2 * np.maximum(ahead, 0.0))
    passed = np.arange(len(begin_m)) < here[:, None]
    return np.asarray(np.where(passed, np.inf, bound).min(axis=1))


def _slow(
    futures: Futures, paths: PlannedPaths, row: int, begin_m: FloatArray, bound_mps: FloatArray
) -> None:
    """Drive the path of *row* at the bounds where its plan is faster, in place."""
    dt, planned = futures.dt_s, futures.speed_mps[row, 1:].copy()
    speed, s = float(futures.speed_mps[row, 0]), 0.0
    driven, speeds = np.empty(futures.steps), np.empty(futures.steps)
    for k in range(futures.steps):
        allowed = float(allowed_mps(begin_m, bound_mps, np.array([s + speed * dt]))[0])
        wanted = min(float(planned[k]), max(allowed, speed - EASE_MPS2 * dt))
        s += 0.5 * dt * (speed + wanted)
        driven[k], speeds[k], speed = s, wanted, wanted
    futures.put(row, *paths.at(row, driven), speeds)
