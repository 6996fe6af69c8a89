"""Derives motion from annotated boxes: signed speeds, parked agents, and standing periods without jitter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.scene import AgentClass, Tracks

PARKED_EXTENT_M = 1.0
PARKED_SPEED_MPS = 1.0
STILL_EXTENT_M, STILL_S = 0.25, 2.0
"""An agent that stays within this distance of one position for at least this time stands there."""
_STANDING_M = 0.05  # instants this close to the median position always belong to the stand
_MOST_INCREASE = 3.0  # upper bound of a speed, relative to those of the adjoining intervals


def signed_speeds(xy_m: FloatArray, yaw_rad: FloatArray, valid: BoolArray, dt_s: float) -> FloatArray:
    """Return speeds (A, T) along the heading by central differences; NaN where not valid.

    At the ends of a track and beside a gap, the speed of the only adjoining interval is taken. A single keyframe has
    speed 0. A speed never exceeds three times that of an adjoining interval, since a car that moves 5 cm after a
    keyframe was nearly standing at it. It is 0 where the direction of motion reverses.

    Args:
        xy_m: (A, T, 2) box centres.
        yaw_rad: (A, T) headings.
        valid: (A, T) whether the agent is annotated at each instant.
        dt_s: spacing of the instants.
    """
    agents = len(xy_m)
    heading = unit(yaw_rad)
    is_interval = valid[:, 1:] & valid[:, :-1]
    velocity = np.where(is_interval[..., None], np.diff(xy_m, axis=1) / dt_s, 0.0)
    zero, false = np.zeros((agents, 1, 2)), np.zeros((agents, 1), dtype=np.bool_)
    after = (np.concatenate((velocity, zero), 1) * heading).sum(-1)
    before = (np.concatenate((zero, velocity), 1) * heading).sum(-1)
    has_after = np.concatenate((is_interval, false), 1)
    has_before = np.concatenate((false, is_interval), 1)
    bound = _MOST_INCREASE * np.minimum(np.abs(after), np.abs(before))
    central = np.where(after * before > 0.0, np.clip(0.5 * (after + before), -bound, bound), 0.0)
    speed = np.where(has_after & has_before, central, np.where(has_after, after, before))
    return np.where(valid, np.where(has_after | has_before, speed, 0.0), np.nan)


def annotated_tracks(
    ids: Iterable[str],
    classes: Sequence[AgentClass | None],
    size_m: FloatArray,
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    dt_s: float,
) -> Tracks:
    """Return the tracks of A annotated agents, with speeds by :func:`signed_speeds`.

    Args:
        ids: A names.
        classes: A classes.
        size_m: (A, 2) lengths and widths.
        xy_m: (A, T, 2) box centres; NaN where an agent is absent.
        yaw_rad: (A, T) headings; NaN where an agent is absent.
        dt_s: spacing of the instants.
    """
    valid = np.isfinite(xy_m).all(-1) & np.isfinite(yaw_rad)
    speed = signed_speeds(xy_m, yaw_rad, valid, dt_s)
    kinds = np.array(classes, dtype=np.int64)
    return Tracks(tuple(ids), kinds, size_m, xy_m, yaw_rad, speed, valid, 0.0, dt_s)


def parked_agents(xy_m: FloatArray, valid: BoolArray, dt_s: float) -> BoolArray:
    """Return (A,) whether each agent never moves beyond annotation noise.

    An agent is parked if it stays within 1 m of its median position over its whole track, and if its net displacement,
    divided by its time in view, is at most 1 m/s. The first rule distinguishes drift of the annotation (nuScenes: up to
    0.9 m while the ego approaches a parked car) from driving. The second excludes a moving car that is seen for only
    one or two keyframes.

    Args:
        xy_m: (A, T, 2) box centres.
        valid: (A, T) whether the agent is annotated at each instant.
        dt_s: spacing of the instants.
    """
    parked = np.zeros(len(xy_m), dtype=np.bool_)
    for row in range(len(xy_m)):
        instants = np.flatnonzero(valid[row])
        if len(instants) == 0:
            continue
        path = xy_m[row, instants]
        extent_m = np.linalg.norm(path - np.median(path, axis=0), axis=-1).max()
        in_view_s = max(dt_s * (instants[-1] - instants[0]), dt_s)
        net_mps = np.linalg.norm(path[-1] - path[0]) / in_view_s
        parked[row] = extent_m <= PARKED_EXTENT_M and net_mps <= PARKED_SPEED_MPS
    return parked


def without_jitter(tracks: Tracks, parked: BoolArray, ego: int) -> Tracks:
    """Return *tracks* in which standing agents do not move; their annotations wander by up to a metre.

    A parked agent that is not a pedestrian has its median position and heading throughout. Any other agent has them
    while it stays within ``STILL_EXTENT_M`` of one position for at least ``STILL_S``. Speeds are then 0. The ego is not
    annotated and remains unchanged.

    Args:
        tracks: tracks of A agents.
        parked: (A,) result of :func:`parked_agents`.
        ego: row of the recording vehicle.
    """
    xy, yaw, speed = tracks.xy_m.copy(), tracks.yaw_rad.copy(), tracks.speed_mps.copy()
    stands_always = parked & (tracks.classes != AgentClass.PEDESTRIAN)
    for row in range(tracks.agents):
        instants = np.flatnonzero(tracks.valid[row])
        if row == ego or not len(instants):
            continue
        for stand in [instants] if stands_always[row] else _stands(tracks.xy_m[row], instants, tracks.dt_s):
            xy[row, stand] = np.median(tracks.xy_m[row, stand], axis=0)
            yaw[row, stand] = _median_angle(tracks.yaw_rad[row, stand])
            speed[row, stand] = 0.0
    return replace(tracks, xy_m=xy, yaw_rad=yaw, speed_mps=speed)


def _stands(xy_m: FloatArray, instants: IntArray, dt_s: float) -> Iterator[IntArray]:
    """Yield the instants of each standing period of an agent at *xy_m* (T, 2), annotated at *instants* (K,)."""
    min_count = round(STILL_S / dt_s) + 1
    first = 0
    while first + min_count <= len(instants):
        has_left = np.linalg.norm(xy_m[instants[first:]] - xy_m[instants[first]], axis=-1) > STILL_EXTENT_M
        count = int(has_left.argmax()) if has_left.any() else len(has_left)
        if count < min_count:
            first += 1
            continue
        stand = instants[first : first + count]
        distance_m = np.linalg.norm(xy_m[stand] - np.median(xy_m[stand], axis=0), axis=-1)
        close = np.flatnonzero(distance_m <= max(_STANDING_M, float(np.median(distance_m))))
        stand = stand[close[0] : close[-1] + 1]  # without arriving and leaving
        if len(stand) >= min_count:
            yield stand
        first += count


def _median_angle(angle_rad: FloatArray) -> float:
    """Return the median of angles (K,), taken over their differences from the first one."""
    difference = wrap_angle(angle_rad - angle_rad[0])
    return float(wrap_angle(angle_rad[0] + np.median(difference)))
