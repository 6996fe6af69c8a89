"""The exact check of a drive among recorded road users."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.bicycle import rollout
from advdiff_sumo.core.boxes import corners, separation
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.polylines import stations_m
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.reference.drive_contact import is_behind

BRAKES_MPS2 = np.arange(1.0, 8.25, 0.5)
"""With which the target brakes on its recorded way …"""
DELAYS_S = np.arange(5.0)
"""… after it has driven as recorded for so long."""
OFF_SHARE = 0.02
"""Most of the box that may be off the road, or as much as was already."""


@dataclass(frozen=True)
class TargetSurroundings:
    """What is around the target while it may drive otherwise.

    Attributes:
        ids: N other road users.
        states: (N, T + 1, 4) x, y, yaw, speed at the record's step; NaN for who is not there.
        size_m: (N, 2) of their boxes.
        start: (4,) the target's state at the beginning.
        target_size_m: (2,) of its box.
        dt_s: the record's step.
    """

    ids: tuple[str, ...]
    states: FloatArray
    size_m: FloatArray
    start: FloatArray
    target_size_m: FloatArray
    dt_s: float

    @property
    def steps(self) -> int:
        """Number of instants T after the first."""
        return int(self.states.shape[1]) - 1


def surroundings(tracks: Tracks, target: int, begin: int, steps: int) -> TargetSurroundings:
    """Return what is around *target* for *steps* instants after *begin*; beyond the record, velocities are kept."""
    every = np.concatenate((tracks.xy_m, tracks.yaw_rad[..., None], tracks.speed_mps[..., None]), axis=-1)
    last = min(begin + steps, tracks.steps - 1)
    recorded = every[:, begin : last + 1]
    late = tracks.dt_s * np.arange(1, begin + steps - last + 1)
    final = every[:, last]
    ahead = np.repeat(final[:, None], len(late), axis=1)
    ahead[..., :2] += (final[:, 3, None] * late)[..., None] * unit(final[:, 2])[:, None]
    rows = np.arange(tracks.agents) != target
    return TargetSurroundings(
        ids=tuple(name for name, other in zip(tracks.ids, rows, strict=True) if other),
        states=np.concatenate((recorded, ahead), axis=1)[rows],
        size_m=tracks.size_m[rows],
        start=every[target, begin],
        target_size_m=tracks.size_m[target],
        dt_s=tracks.dt_s,
    )


def drive(
    around: TargetSurroundings, accel_mps2: FloatArray, curvature_1pm: FloatArray, stride: int
) -> FloatArray:
    """Return the target's states (K, T + 1, 4) under actions (K, S) that each last *stride* instants."""
    count = len(accel_mps2)
    start = np.repeat(around.start[None], count, axis=0)
    accel, curvature = (np.repeat(part, stride, axis=1) for part in (accel_mps2, curvature_1pm))
    speed = np.maximum(start[:, 3], 0.0)
    xy, yaw, moving = rollout(start[:, :2], start[:, 2], speed, accel, curvature, around.dt_s)
    later = np.concatenate((xy, yaw[..., None], moving[..., None]), axis=-1)
    return np.concatenate((start[:, None], later), axis=1)


def braked(
    tracks: Tracks, target: int, begin: int, steps: int, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return accelerations and curvatures (K, S) that brake *target* on its recorded way, straight on beyond it.

    It brakes by each of ``BRAKES_MPS2``, after each of ``DELAYS_S`` in which it drives as recorded.

    Args:
        tracks: the record.
        target: its row.
        begin: the first instant of the drives.
        steps: S.
        step_s: of the actions.
    """
    here = np.flatnonzero(tracks.valid[target, begin:]) + begin
    along, yaw = stations_m(tracks.xy_m[target, here]), np.unwrap(tracks.yaw_rad[target, here])
    later = step_s * np.arange(steps + 1)
    recorded = np.interp(later, tracks.dt_s * (here - begin), np.maximum(tracks.speed_mps[target, here], 0.0))
    brake, delay = (part.reshape(-1, 1) for part in np.meshgrid(BRAKES_MPS2, DELAYS_S))
    accel = np.where(later[:-1] < delay - 1e-9, np.diff(recorded) / step_s, -brake)
    begun = np.full((len(brake), 1), recorded[0])
    speed = np.hstack((begun, np.maximum(begun + step_s * np.cumsum(accel, axis=1), 0.0)))
    driven = np.where(
        speed[:, 1:] > 0.0, step_s * speed[:, :-1] + 0.5 * accel * step_s**2, 0.5 * speed[:, :-1] ** 2 / brake
    )
    place = np.hstack((np.zeros_like(begun), np.cumsum(driven, axis=1)))
    turned = np.diff(np.interp(place, along, yaw), axis=1)
    return accel, turned / np.maximum(driven, 0.1)


def usable(
    road: RoadMap, around: TargetSurroundings, states: FloatArray, counted: Collection[str] | None = None
) -> BoolArray:
    """Return (K,) which drives *states* (K, T + 1, 4) collide with nobody and stay on the road.

    Who overlaps the target at the very beginning is left out, as nothing that it does can undo that.

    Args:
        road: the map.
        around: what is around the target.
        states: x, y, yaw and speed of the drives.
        counted: of those who run into the rear of a drive, the ones that count, as in the verdict; None: all.
    """
    size = np.broadcast_to(around.target_size_m, (*states.shape[:2], 2))
    boxes = corners(states[..., :2], states[..., 2], size)
    others = around.states
    around_size = np.broadcast_to(around.size_m[:, None], (*others.shape[:2], 2))
    theirs = corners(others[..., :2], others[..., 2], around_size)
    fine = on_road(road, boxes)
    present = np.asarray(np.isfinite(others).all(axis=-1))
    with np.errstate(invalid="ignore"):
        for name, own, there, xy_m in zip(around.ids, theirs, present, others[..., :2], strict=True):
            touches = (separation(boxes, np.broadcast_to(own, boxes.shape)) < 0.0) & there
            if touches[:, 0].any():
                continue
            collides = touches.any(axis=1)
            if counted is not None and name not in counted:
                at = touches.argmax(axis=1)
                now = states[np.arange(len(states)), at]
                collides &= ~is_behind(xy_m[at], now[:, :2], now[:, 2], around.target_size_m[0])
            fine &= ~collides
    return fine


def on_road(road: RoadMap, boxes: FloatArray) -> BoolArray:
    """Return (K,) which sequences of boxes (K, T + 1, 4, 2) stay on the road, or no farther off than they began."""
    inside = road.covers(boxes).all(axis=-1)
    share = np.zeros(inside.shape)
    if not inside.all():
        share[~inside] = road.off_road_share(boxes[~inside])
    return np.asarray((share <= np.maximum(OFF_SHARE, share[:, :1])).all(axis=1))
