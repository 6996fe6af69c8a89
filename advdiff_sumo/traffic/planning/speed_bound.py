"""Slows vehicles along their planned paths to a share of the speed limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.traffic.planning.futures import Futures
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.planning.planned_paths import PlannedPaths

EASE_MPS2 = 2.5
"""Deceleration ahead of a lower limit, and from a speed above the limit."""
NO_LANE_MPS = 5.0
"""Speed limit without a lane."""
_TOLERANCE_MPS = 0.05


def bound_speeds(
    futures: Futures,
    rows: IntArray,
    lanes: Sequence[LaneAhead | None],
    limits_mps: Mapping[str, float],
    share: FloatArray,
) -> None:
    """Let *rows* (V,) drive no faster than their *share* of the speed limit, in place.

    A vehicle that is faster now slows down with ``EASE_MPS2``.

    Args:
        futures: plans of N road users.
        rows: whose plans are bounded.
        lanes: lanes that each of N road users would follow.
        limits_mps: lane → its legal limit.
        share: (N,) highest share of the limit.
    """
    driven, fastest = futures.travelled_m(), futures.speed_mps[:, 1:].max(axis=1).tolist()
    slowing = futures.speed_mps[:, :1] - EASE_MPS2 * futures.dt_s * np.arange(1, futures.steps + 1)
    paths: PlannedPaths | None = None
    for row in rows.tolist():
        if fastest[row] <= share[row] * _lowest_mps(lanes[row], limits_mps):
            continue
        begin, bound = sections(lanes[row], limits_mps, float(share[row]))
        allowed = np.maximum(allowed_mps(begin, bound, driven[row, 1:]), slowing[row])
        if (futures.speed_mps[row, 1:] <= allowed + _TOLERANCE_MPS).all():
            continue
        paths = paths or PlannedPaths(futures.copy())
        _slow(futures, paths, row, begin, bound)


def _lowest_mps(lane: LaneAhead | None, limits_mps: Mapping[str, float]) -> float:
    return 0.0 if lane is None else min(limits_mps[part.id] for part in lane.lanes)


def sections(
    lane: LaneAhead | None, limits_mps: Mapping[str, float], share: float
) -> tuple[FloatArray, FloatArray]:
    """Return the distances (K,) to the lanes ahead, 0 for the present one, and *share* of their limits (K,)."""
    if lane is None:
        return np.zeros(1), np.full(1, NO_LANE_MPS)
    ends = np.cumsum([part.length_m for part in lane.lanes]) - lane.s_m
    return np.append(0.0, ends[:-1]), share * np.array([limits_mps[part.id] for part in lane.lanes])


def allowed_mps(begin_m: FloatArray, bound_mps: FloatArray, s_m: FloatArray) -> FloatArray:
    """Return (T,) the highest speeds at *s_m* (T,) that keep the bounds (K,) of sections from *begin_m* (K,) on.

    A bound ahead counts by the speed from which ``EASE_MPS2`` reaches it in time.
    """
    ahead = begin_m - s_m[:, None]
    section = np.maximum(np.searchsorted(begin_m, s_m, side="right") - 1, 0)
    bound = np.sqrt(bound_mps**2 + 2.0 * EASE_MPS2 * np.maximum(ahead, 0.0))
    passed = np.arange(len(begin_m)) < section[:, None]
    return np.asarray(np.where(passed, np.inf, bound).min(axis=1))


def _slow(
    futures: Futures, paths: PlannedPaths, row: int, begin_m: FloatArray, bound_mps: FloatArray
) -> None:
    """Let *row* drive its path at the bounds where its plan is faster, in place."""
    dt, planned = futures.dt_s, futures.speed_mps[row, 1:].copy()
    speed, s = float(futures.speed_mps[row, 0]), 0.0
    driven, speeds = np.empty(futures.steps), np.empty(futures.steps)
    for k in range(futures.steps):
        allowed = float(allowed_mps(begin_m, bound_mps, np.array([s + speed * dt]))[0])
        desired_mps = min(float(planned[k]), max(allowed, speed - EASE_MPS2 * dt))
        s += 0.5 * dt * (speed + desired_mps)
        driven[k], speeds[k], speed = s, desired_mps, desired_mps
    futures.put(row, *paths.at(row, driven), speeds)
