"""Extend a record: after its end all road users keep their heading and their speed or braking."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import quotient
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import Tracks


def extended_tracks(tracks: Tracks, begin: int, after: int) -> Tracks:
    """Return the instants from *begin* on and *after* more, with heading and last braking (or else speed) kept."""
    recorded = tracks.window(begin, tracks.steps)
    time = tracks.dt_s * np.arange(1, after + 1)
    last = recorded.speed_mps[:, -1]
    before = recorded.speed_mps[:, -2] if recorded.steps > 1 else recorded.speed_mps[:, -1]
    braking = np.clip((np.abs(before) - np.abs(last)) / tracks.dt_s, 0.0, 8.0)
    braking = np.where(np.isfinite(braking), braking, 0.0)[:, None]
    stop_s = quotient(np.abs(last)[:, None], braking)
    moving_s = np.minimum(time, stop_s)
    sign = np.sign(last)[:, None]
    driven_m = last[:, None] * moving_s - 0.5 * sign * braking * moving_s**2
    heading = np.repeat(recorded.yaw_rad[:, -1:], after, axis=1)
    xy = recorded.xy_m[:, -1:] + driven_m[..., None] * unit(heading)
    speed = last[:, None] - sign * braking * moving_s
    valid = np.repeat(recorded.valid[:, -1:], after, axis=1)
    return replace(
        recorded,
        xy_m=np.concatenate((recorded.xy_m, xy), axis=1),
        yaw_rad=np.concatenate((recorded.yaw_rad, heading), axis=1),
        speed_mps=np.concatenate((recorded.speed_mps, speed), axis=1),
        valid=np.concatenate((recorded.valid, valid), axis=1),
    )
