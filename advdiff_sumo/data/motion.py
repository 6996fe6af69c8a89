"""What annotated boxes say about motion: signed speeds, and who never moves."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit

PARKED_EXTENT_M = 1.0
PARKED_SPEED_MPS = 1.0
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
