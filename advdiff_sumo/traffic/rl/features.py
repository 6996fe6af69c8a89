"""The observation of an attacker: numbers in its own frame (x forward, y left), scaled to about 1."""

from __future__ import annotations

from typing import Final

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.core.frames import local_from_world, unit, wrap_angle
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.traffic.planning.futures import Futures
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead

OTHERS: Final = 3
"""Number of nearest road users that are observed besides the target."""
LIMIT: Final = 5.0
"""Every feature is clipped to ± this."""
_AHEAD_M = (10.0, 20.0, 30.0)
"""Distances ahead at which the heading of the lane is observed."""
_FUTURE_STEPS = (2, 4, 6)
"""Model steps after which the target's natural position is observed."""
_OWN, _LANE, _TARGET, _OTHER = 7, 7, 22, 8
"""Numbers of features of each part."""
FEATURES: Final = _OWN + _LANE + _TARGET + OTHERS * _OTHER
"""Number of features of an observation."""


def observe(
    road: RoadMap,
    now: Tracks,
    natural: Futures,
    row: int,
    lane: LaneAhead | None,
    action: tuple[float, float],
) -> FloatArray:
    """Return the observation (F,) of one vehicle.

    Args:
        road: the map.
        now: histories of the view, the target first.
        natural: all futures by the behaviour model, from now on.
        row: row of the vehicle.
        lane: lanes that it would follow; None if it is on none.
        action: the behaviour model's next acceleration (m/s²) and curvature (1/m).
    """
    parts = (
        _own(now, row, action),
        _lane(road, now, row, lane),
        _target(now, natural, row),
        _others(natural, row),
    )
    observation = np.nan_to_num(np.concatenate(parts), nan=0.0, posinf=LIMIT, neginf=-LIMIT)
    return np.asarray(np.clip(observation, -LIMIT, LIMIT), dtype=np.float64)


def _own(now: Tracks, row: int, action: tuple[float, float]) -> FloatArray:
    """Return speed, acceleration, yaw rate, size, and the natural next accelerations (7)."""
    speed = now.speed_mps[row, -1]
    accel, yaw_rate = _rates(now, row)
    lateral = action[1] * speed**2
    length, width = now.size_m[row]
    return np.array(
        [
            0.1 * speed,
            0.25 * accel,
            2.0 * yaw_rate,
            0.2 * length,
            0.5 * width,
            0.25 * action[0],
            0.5 * lateral,
        ]
    )


def _rates(now: Tracks, row: int) -> tuple[float, float]:
    """Return the acceleration and yaw rate in the step up to now; 0 without a known past."""
    if now.steps < 2 or not now.valid[row, -2]:
        return 0.0, 0.0
    accel = (now.speed_mps[row, -1] - now.speed_mps[row, -2]) / now.dt_s
    yaw_rate = float(wrap_angle(now.yaw_rad[row, -1] - now.yaw_rad[row, -2])) / now.dt_s
    return float(accel), yaw_rate


def _lane(road: RoadMap, now: Tracks, row: int, lane: LaneAhead | None) -> FloatArray:
    """Return presence, offset, heading error, turns of the lane ahead, and distance to the road's edge (7)."""
    xy, yaw = now.xy_m[row, -1], now.yaw_rad[row, -1]
    edge = 0.2 * float(road.drivable_edge_distance(xy[None])[0])
    if lane is None:
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, edge])
    heading = np.array([_heading(lane, ahead) for ahead in (0.0, *_AHEAD_M)])
    turn = wrap_angle(heading[1:] - heading[0])
    error = float(wrap_angle(yaw - heading[0]))
    return np.array([1.0, 0.5 * lane.offset_m, 2.0 * error, *turn, edge])


def _heading(lane: LaneAhead, ahead_m: float) -> float:
    """Return the heading of the lanes *ahead_m* farther on, at most at the end of the last one."""
    s = lane.s_m + ahead_m
    for part in lane.lanes:
        if s <= part.length_m:
            return float(part.line.at(s)[1])
        s -= part.length_m
    return float(lane.lanes[-1].line.at(lane.lanes[-1].length_m)[1])


def _target(now: Tracks, natural: Futures, row: int) -> FloatArray:
    """Return the target's position, motion, size and natural future relative to *row* (22)."""
    accel, yaw_rate = _rates(now, 0)
    length, width = now.size_m[0]
    xy, yaw = natural.xy_m, natural.yaw_rad
    future = [local_from_world(xy[0, k], xy[row, k], yaw[row, k]) for k in _FUTURE_STEPS]
    distance = np.linalg.norm(xy[0] - xy[row], axis=-1)
    closest = int(distance.argmin())
    return np.array(
        [
            *_relative(natural, row, 0),
            np.exp(-0.1 * distance[0]),
            0.1 * _gap_m(natural, row, 0),
            0.25 * accel,
            2.0 * yaw_rate,
            0.2 * length,
            0.5 * width,
            *(0.05 * np.concatenate(future)),
            0.05 * distance[closest],
            closest * MODEL_STEP_S / 4.0,
            0.1 * natural.speed_mps[0, 0],
        ]
    )


def _relative(natural: Futures, row: int, other: int) -> FloatArray:
    """Return position, heading, relative velocity and presence (7) of *other* in the frame of *row*, now."""
    yaw = natural.yaw_rad[row, 0]
    position = local_from_world(natural.xy_m[other, 0], natural.xy_m[row, 0], yaw)
    velocity = natural.speed_mps[other, 0] * unit(natural.yaw_rad[other, 0])
    velocity = velocity - natural.speed_mps[row, 0] * unit(yaw)
    local_velocity = local_from_world(velocity, np.zeros(2), yaw)
    turn = natural.yaw_rad[other, 0] - yaw
    return np.array([*(0.05 * position), np.cos(turn), np.sin(turn), *(0.1 * local_velocity), 1.0])


def _others(natural: Futures, row: int) -> FloatArray:
    """Return the nearest road users besides the target, nearest first (OTHERS × 8); 0 where there are fewer."""
    distance = np.linalg.norm(natural.xy_m[:, 0] - natural.xy_m[row, 0], axis=-1)
    distance[[0, row]] = np.inf
    features = np.zeros((OTHERS, _OTHER))
    for rank, other in enumerate(np.argsort(distance, kind="stable")[:OTHERS].tolist()):
        if np.isfinite(distance[other]):
            features[rank] = (*_relative(natural, row, other), 0.2 * natural.size_m[other, 0])
    return features.ravel()


def _gap_m(natural: Futures, row: int, other: int) -> float:
    """Return the gap between the boxes of two vehicles now: the largest separation along any of their axes."""
    half = 0.5 * natural.size_m
    gaps = axis_gaps(
        natural.xy_m[other, 0] - natural.xy_m[row, 0],
        natural.yaw_rad[row, 0],
        half[row],
        natural.yaw_rad[other, 0],
        half[other],
    )[0]
    return float(gaps.max())
