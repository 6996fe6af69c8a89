"""Velocities and unbroken stretches of recorded tracks."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.metrics.target_contact import JUMP_MPS

#: A faster lateral motion is an instantaneous lane change.
SNAP_MPS = 8.0
#: A pedestrian who moves faster than its speed by more than this is put from one path onto the next.
WALK_SNAP_MPS = 1.0


def unbroken_steps(tracks: Tracks) -> BoolArray:
    """Return (A, T − 1) whether the agent is present at both ends of the step and does not jump between them."""
    present = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    move = np.diff(tracks.xy_m, axis=1)
    return np.asarray(present & (np.hypot(move[..., 0], move[..., 1]) <= JUMP_MPS * tracks.dt_s))


def snaps(tracks: Tracks) -> BoolArray:
    """Return (A, T − 1) whether the agent is put elsewhere in the step, within ``JUMP_MPS``; False where it is absent.

    A vehicle moves sideways faster than ``SNAP_MPS``, as SUMO changes lanes without its sublane model. A pedestrian
    moves faster than its speed by over ``WALK_SNAP_MPS``, as at SUMO's corners of sidewalks and crossings.
    """
    move = np.diff(tracks.xy_m, axis=1)
    yaw = tracks.yaw_rad[:, :-1] + 0.5 * np.angle(np.exp(1j * np.diff(tracks.yaw_rad, axis=1)))
    sideways = move[..., 1] * np.cos(yaw) - move[..., 0] * np.sin(yaw)
    snapped = np.abs(sideways) > SNAP_MPS * tracks.dt_s
    speed = np.abs(tracks.speed_mps)
    walked = (np.maximum(speed[:, 1:], speed[:, :-1]) + WALK_SNAP_MPS) * tracks.dt_s
    walks = (tracks.classes == AgentClass.PEDESTRIAN)[:, None]
    return np.asarray(snapped | (walks & (np.hypot(move[..., 0], move[..., 1]) > walked)))


def velocities(tracks: Tracks) -> FloatArray:
    """Return (A, T, 2) velocities in m/s from the positions: the mean of the steps before and after an instant.

    Velocities from positions include lateral motion. A step with a break or an instantaneous lane change is not used.
    If neither step can be used, the velocity is the speed along the heading. NaN where the agent is absent.
    """
    usable = unbroken_steps(tracks) & ~snaps(tracks)
    rate = np.where(usable[..., None], np.diff(tracks.xy_m, axis=1) / tracks.dt_s, 0.0)
    total = np.zeros_like(tracks.xy_m)
    count = np.zeros(tracks.yaw_rad.shape)
    for part in (slice(1, None), slice(None, -1)):
        total[:, part] += rate
        count[:, part] += usable
    heading = np.stack((np.cos(tracks.yaw_rad), np.sin(tracks.yaw_rad)), axis=-1)
    along_heading = tracks.speed_mps[..., None] * heading
    mean = total / np.maximum(count, 1.0)[..., None]
    velocity = np.where((count > 0.0)[..., None], mean, along_heading)
    return np.where(tracks.valid[..., None], velocity, np.nan)
