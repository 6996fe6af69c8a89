"""Checks exactly whether a trajectory of the target is free of collisions with recorded road users."""

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
"""Decelerations with which the target brakes on its recorded path."""
DELAYS_S = np.arange(5.0)
"""Times for which it drives as recorded before it brakes."""
OFF_SHARE = 0.02
"""Share of the box that may be off the road; more only if more was off the road at the beginning."""


@dataclass(frozen=True)
class TargetSurroundings:
    """The road users around the target during the search.

    Attributes:
        ids: of the N other road users.
        states: (N, T + 1, 4) x, y, yaw, speed at the record's step; NaN for absent ones.
        size_m: (N, 2) of their boxes.
        start: (4,) the target's state at the beginning.
        target_size_m: (2,) of the target's box.
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
    """Return the others around *target* for *steps* instants after *begin*; beyond the record at constant velocity."""
    states = np.concatenate((tracks.xy_m, tracks.yaw_rad[..., None], tracks.speed_mps[..., None]), axis=-1)
    last = min(begin + steps, tracks.steps - 1)
    recorded = states[:, begin : last + 1]
    beyond_s = tracks.dt_s * np.arange(1, begin + steps - last + 1)
    final = states[:, last]
    extrapolated = np.repeat(final[:, None], len(beyond_s), axis=1)
    extrapolated[..., :2] += (final[:, 3, None] * beyond_s)[..., None] * unit(final[:, 2])[:, None]
    is_other = np.arange(tracks.agents) != target
    return TargetSurroundings(
        ids=tuple(name for name, keep in zip(tracks.ids, is_other, strict=True) if keep),
        states=np.concatenate((recorded, extrapolated), axis=1)[is_other],
        size_m=tracks.size_m[is_other],
        start=states[target, begin],
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
    xy, yaw, speeds = rollout(start[:, :2], start[:, 2], speed, accel, curvature, around.dt_s)
    later = np.concatenate((xy, yaw[..., None], speeds[..., None]), axis=-1)
    return np.concatenate((start[:, None], later), axis=1)


def braked(
    tracks: Tracks, target: int, begin: int, steps: int, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return accelerations and curvatures (K, S) that brake *target* on its recorded path, straight on beyond its end.

    They combine each deceleration of ``BRAKES_MPS2`` with each delay of ``DELAYS_S``.

    Args:
        tracks: the record.
        target: its row.
        begin: the first instant of the trajectories.
        steps: S.
        step_s: duration of an action.
    """
    instants = np.flatnonzero(tracks.valid[target, begin:]) + begin
    station_m, yaw = stations_m(tracks.xy_m[target, instants]), np.unwrap(tracks.yaw_rad[target, instants])
    times_s = step_s * np.arange(steps + 1)
    speeds = np.maximum(tracks.speed_mps[target, instants], 0.0)
    recorded = np.interp(times_s, tracks.dt_s * (instants - begin), speeds)
    brake, delay = (part.reshape(-1, 1) for part in np.meshgrid(BRAKES_MPS2, DELAYS_S))
    accel = np.where(times_s[:-1] < delay - 1e-9, np.diff(recorded) / step_s, -brake)
    start_speed = np.full((len(brake), 1), recorded[0])
    speed = np.hstack((start_speed, np.maximum(start_speed + step_s * np.cumsum(accel, axis=1), 0.0)))
    distance = np.where(
        speed[:, 1:] > 0.0, step_s * speed[:, :-1] + 0.5 * accel * step_s**2, 0.5 * speed[:, :-1] ** 2 / brake
    )
    station = np.hstack((np.zeros_like(start_speed), np.cumsum(distance, axis=1)))
    yaw_change = np.diff(np.interp(station, station_m, yaw), axis=1)
    return accel, yaw_change / np.maximum(distance, 0.1)


def usable(
    road: RoadMap, around: TargetSurroundings, states: FloatArray, counted: Collection[str] | None = None
) -> BoolArray:
    """Return which trajectories (K,) collide with nobody and stay on the road.

    Road users that overlap the target at the first instant are ignored, as no action can avoid that.

    Args:
        road: the map.
        around: the others around the target.
        states: (K, T + 1, 4) x, y, yaw and speed of the trajectories.
        counted: ids of road users that count even if they run into the target's rear, as in the verdict; None: all.
    """
    target_size_m = np.broadcast_to(around.target_size_m, (*states.shape[:2], 2))
    boxes = corners(states[..., :2], states[..., 2], target_size_m)
    others = around.states
    other_sizes_m = np.broadcast_to(around.size_m[:, None], (*others.shape[:2], 2))
    other_boxes = corners(others[..., :2], others[..., 2], other_sizes_m)
    is_usable = on_road(road, boxes)
    is_present = np.asarray(np.isfinite(others).all(axis=-1))
    with np.errstate(invalid="ignore"):
        for name, other_box, present, xy_m in zip(
            around.ids, other_boxes, is_present, others[..., :2], strict=True
        ):
            touches = (separation(boxes, np.broadcast_to(other_box, boxes.shape)) < 0.0) & present
            if touches[:, 0].any():
                continue
            collides = touches.any(axis=1)
            if counted is not None and name not in counted:
                first_touch = touches.argmax(axis=1)
                pose = states[np.arange(len(states)), first_touch]
                collides &= ~is_behind(xy_m[first_touch], pose[:, :2], pose[:, 2], around.target_size_m[0])
            is_usable &= ~collides
    return is_usable


def on_road(road: RoadMap, boxes: FloatArray) -> BoolArray:
    """Return which sequences (K,) of boxes (K, T + 1, 4, 2) stay on the road, or no farther off it than at first."""
    inside = road.covers(boxes).all(axis=-1)
    share = np.zeros(inside.shape)
    if not inside.all():
        share[~inside] = road.off_road_share(boxes[~inside])
    return np.asarray((share <= np.maximum(OFF_SHARE, share[:, :1])).all(axis=1))
