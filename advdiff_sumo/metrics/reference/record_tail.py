"""What a record would have gone on to show: everybody keeps heading and speed, or braking."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import quotient
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import Tracks


def extended(tracks: Tracks, begin: int, after: int) -> Tracks:
    """Return instants from *begin* on, and *after* more in which everybody keeps heading and braking, or speed."""
    cut = tracks.window(begin, tracks.steps)
    time = tracks.dt_s * np.arange(1, after + 1)
    speed, before = cut.speed_mps[:, -1], cut.speed_mps[:, -2] if cut.steps > 1 else cut.speed_mps[:, -1]
    braking = np.clip((np.abs(before) - np.abs(speed)) / tracks.dt_s, 0.0, 8.0)
    braking = np.where(np.isfinite(braking), braking, 0.0)[:, None]
    stop = quotient(np.abs(speed)[:, None], braking)
    moving = np.minimum(time, stop)
    sign = np.sign(speed)[:, None]
    driven = speed[:, None] * moving - 0.5 * sign * braking * moving**2
    heading = np.repeat(cut.yaw_rad[:, -1:], after, axis=1)
    xy = cut.xy_m[:, -1:] + driven[..., None] * unit(heading)
    pace = speed[:, None] - sign * braking * moving
    there = np.repeat(cut.valid[:, -1:], after, axis=1)
    return replace(
        cut,
        xy_m=np.concatenate((cut.xy_m, xy), axis=1),
        yaw_rad=np.concatenate((cut.yaw_rad, heading), axis=1),
        speed_mps=np.concatenate((cut.speed_mps, pace), axis=1),
        valid=np.concatenate((cut.valid, there), axis=1),
    )
