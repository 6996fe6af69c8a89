"""What annotated boxes say about motion: signed speeds, who never moves, and what stands still in spite of jitter."""

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
"""Who stays within so much of one place for at least so long stands there."""
_STARTS_M = 0.05
_MONOTONE = 3.0


def signed_speeds(xy_m: FloatArray, yaw_rad: FloatArray, valid: BoolArray, dt_s: float) -> FloatArray:
    """Return speeds (A, T) along the heading from central differences; NaN where not valid.

    At the ends of a track and beside a gap the one adjoining interval counts; a lone keyframe has speed 0.
    A speed never exceeds three times that of an adjoining interval, and is 0 where the agent turns back: a
    car that moves 5 cm after a keyframe was nearly standing at it.

    Args:
        xy_m: (A, T, 2) box centres.
        yaw_rad: (A, T) headings.
        valid: (A, T) annotated instants.
        dt_s: spacing.
    """
    agents = len(xy_m)
    heading = unit(yaw_rad)
    both = valid[:, 1:] & valid[:, :-1]
    step = np.where(both[..., None], np.diff(xy_m, axis=1) / dt_s, 0.0)
    none, no = np.zeros((agents, 1, 2)), np.zeros((agents, 1), dtype=np.bool_)
    after = (np.concatenate((step, none), 1) * heading).sum(-1)
    before = (np.concatenate((none, step), 1) * heading).sum(-1)
    has_after, has_before = np.concatenate((both, no), 1), np.concatenate((no, both), 1)
    bound = _MONOTONE * np.minimum(np.abs(after), np.abs(before))
    central = np.where(after * before > 0.0, np.clip(0.5 * (after + before), -bound, bound), 0.0)
    speed = np.where(has_after & has_before, central, np.where(has_after, after, before))
    return np.where(valid, np.where(has_after | has_before, speed, 0.0), np.nan)


def annotated(
    ids: Iterable[str],
    classes: Sequence[AgentClass | None],
    size_m: FloatArray,
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    dt_s: float,
) -> Tracks:
    """Return the tracks of A annotated agents, with speeds of :func:`signed_speeds`; NaN where they are not there.

    Args:
        ids: A names.
        classes: A classes.
        size_m: (A, 2) lengths and widths.
        xy_m: (A, T, 2) box centres.
        yaw_rad: (A, T) headings.
        dt_s: spacing.
    """
    valid = np.isfinite(xy_m).all(-1) & np.isfinite(yaw_rad)
    speed = signed_speeds(xy_m, yaw_rad, valid, dt_s)
    kinds = np.array(classes, dtype=np.int64)
    return Tracks(tuple(ids), kinds, size_m, xy_m, yaw_rad, speed, valid, 0.0, dt_s)


def parked_agents(xy_m: FloatArray, valid: BoolArray, dt_s: float) -> BoolArray:
    """Return which agents (A,) never move beyond annotation noise.

    An agent is parked when it stays within 1 m of its median position over its whole track and its net
    displacement over its time in view stays below 1 m/s. The first rule tells drift of an annotation
    (nuScenes: up to 0.9 m while the ego approaches a parked car) from driving; the second catches a moving
    car that is seen for a keyframe or two only.

    Args:
        xy_m: (A, T, 2) box centres.
        valid: (A, T) annotated instants.
        dt_s: spacing.
    """
    parked = np.zeros(len(xy_m), dtype=np.bool_)
    for row in range(len(xy_m)):
        known = np.flatnonzero(valid[row])
        if len(known) == 0:
            continue
        path = xy_m[row, known]
        extent = np.linalg.norm(path - np.median(path, axis=0), axis=-1).max()
        seconds = max(dt_s * (known[-1] - known[0]), dt_s)
        net = np.linalg.norm(path[-1] - path[0]) / seconds
        parked[row] = extent <= PARKED_EXTENT_M and net <= PARKED_SPEED_MPS
    return parked


def without_jitter(tracks: Tracks, parked: BoolArray, ego: int) -> Tracks:
    """Return *tracks* in which what stands stands still: annotations of it wander by up to a metre.

    Who is parked, and not on foot, keeps its median position and heading throughout. Anybody else does so while it
    stays within ``STILL_EXTENT_M`` of one place for ``STILL_S`` or longer, from when it is there to when it leaves.
    Speeds are 0 then. The ego is not annotated and stays as it is.

    Args:
        tracks: of A agents.
        parked: (A,) who never moves, as of :func:`parked_agents`.
        ego: row of the recording vehicle.
    """
    xy, yaw, speed = tracks.xy_m.copy(), tracks.yaw_rad.copy(), tracks.speed_mps.copy()
    whole = parked & (tracks.classes != AgentClass.PEDESTRIAN)
    for row in range(tracks.agents):
        there = np.flatnonzero(tracks.valid[row])
        if row == ego or not len(there):
            continue
        for stand in [there] if whole[row] else _stands(tracks.xy_m[row], there, tracks.dt_s):
            xy[row, stand] = np.median(tracks.xy_m[row, stand], axis=0)
            yaw[row, stand] = _median_angle(tracks.yaw_rad[row, stand])
            speed[row, stand] = 0.0
    return replace(tracks, xy_m=xy, yaw_rad=yaw, speed_mps=speed)


def _stands(xy_m: FloatArray, there: IntArray, dt_s: float) -> Iterator[IntArray]:
    """Yield the instants of each stand of one agent, which is *there* (K,) and at *xy_m* (T, 2)."""
    fewest = round(STILL_S / dt_s) + 1
    first = 0
    while first + fewest <= len(there):
        away = np.linalg.norm(xy_m[there[first:]] - xy_m[there[first]], axis=-1) > STILL_EXTENT_M
        count = int(away.argmax()) if away.any() else len(away)
        if count < fewest:
            first += 1
            continue
        stand = there[first : first + count]
        beside = np.linalg.norm(xy_m[stand] - np.median(xy_m[stand], axis=0), axis=-1)
        close = np.flatnonzero(beside <= max(_STARTS_M, float(np.median(beside))))
        stand = stand[close[0] : close[-1] + 1]
        if len(stand) >= fewest:
            yield stand
        first += count


def _median_angle(angle_rad: FloatArray) -> float:
    """Return the median of angles (K,) on the circle, seen from the first one."""
    turned = wrap_angle(angle_rad - angle_rad[0])
    return float(wrap_angle(angle_rad[0] + np.median(turned)))
