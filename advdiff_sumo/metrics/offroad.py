"""Detect when the target leaves the road, and measure how far background vehicles leave it.

A vehicle has left the road when more than half its box lies outside the drivable area. With this bound the result does
not depend on how exactly the net draws its kerbs. A car that cuts a corner or keeps 0.3 m too far right stays far below
it; a car whose centre line has left the road exceeds it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.record import Controller, EpisodeRecord
from advdiff_sumo.core.scene import MOTOR_CLASSES, Tracks
from advdiff_sumo.maps import RoadMap

#: Share of the box outside the drivable area beyond which a vehicle has left the road.
OFF_ROAD_SHARE = 0.5
#: Background vehicles are checked at this interval: the step of the models that move them.
BACKGROUND_EVERY_S = 0.5


@dataclass(frozen=True)
class OffRoad:
    """The event that the target leaves the road.

    Attributes:
        step: instant before it.
        time_s: time since the episode's start, from linear interpolation of the share between instants.
        xy_m: (2,) centre of the target's box at that time.
        speed_mps: speed at that time.
    """

    step: int
    time_s: float
    xy_m: FloatArray
    speed_mps: float


@dataclass(frozen=True)
class BackgroundOffRoad:
    """How far background vehicles moved by a policy left the road.

    The share of the box that was off the road when a vehicle first appeared is subtracted.

    Attributes:
        mean_share: mean share of the box off the road, over vehicles and instants; None without a vehicle.
        max_share: greatest share; None without a vehicle.
        rows: rows of the vehicles whose share exceeded ``OFF_ROAD_SHARE``.
    """

    mean_share: float | None
    max_share: float | None
    rows: tuple[int, ...] = ()

    @property
    def vehicles(self) -> int:
        """Number of vehicles that left the road."""
        return len(self.rows)


def target_leaves_road(record: EpisodeRecord, road: RoadMap) -> OffRoad | None:
    """Return when the target first leaves the road, or None.

    A target that starts off the road counts only once it has been on it. Pedestrians and bicycles do not count.
    """
    tracks, row = record.tracks, record.target
    if tracks.classes[row] not in MOTOR_CLASSES:
        return None
    share = off_road_shares(road, tracks, np.full(tracks.steps, row), np.arange(tracks.steps))
    off = share > OFF_ROAD_SHARE
    leaving_steps = np.flatnonzero(off[1:] & (share[:-1] <= OFF_ROAD_SHARE))
    if not leaving_steps.size:
        return None
    step = int(leaving_steps[0])
    fraction = float((OFF_ROAD_SHARE - share[step]) / (share[step + 1] - share[step]))
    xy, speed = tracks.xy_m[row, step : step + 2], tracks.speed_mps[row, step : step + 2]
    return OffRoad(
        step=step,
        time_s=tracks.t0_s + (step + fraction) * tracks.dt_s,
        xy_m=xy[0] + fraction * (xy[1] - xy[0]),
        speed_mps=float(speed[0] + fraction * (speed[1] - speed[0])),
    )


def background_off_road(record: EpisodeRecord, road: RoadMap) -> BackgroundOffRoad:
    """Return how far motor vehicles moved by the policy left the road, checked every ``BACKGROUND_EVERY_S``.

    The share off the road when a vehicle first appeared (as of a parked car in a log) is subtracted.
    """
    tracks = record.tracks
    moved = (record.controller == Controller.POLICY) & tracks.valid
    moved[record.target] = False
    moved &= np.isin(tracks.classes, MOTOR_CLASSES)[:, None]
    every = max(1, round(BACKGROUND_EVERY_S / tracks.dt_s))
    sampled = np.zeros(tracks.steps, dtype=np.bool_)
    sampled[::every] = True
    row, step = np.nonzero(moved & sampled)
    if not row.size:
        return BackgroundOffRoad(None, None)
    first_step = np.argmax(tracks.valid, axis=1)
    first_share = np.zeros(tracks.agents)
    rows = np.unique(row)
    first_share[rows] = off_road_shares(road, tracks, rows, first_step[rows])
    added = np.maximum(0.0, off_road_shares(road, tracks, row, step) - first_share[row])
    max_added = np.zeros(tracks.agents)
    np.maximum.at(max_added, row, added)
    off_road_rows = tuple(np.flatnonzero(max_added > OFF_ROAD_SHARE).tolist())
    return BackgroundOffRoad(float(added.mean()), float(added.max()), off_road_rows)


def off_road_shares(road: RoadMap, tracks: Tracks, row: IntArray, step: IntArray) -> FloatArray:
    """Return (N,) the shares of the boxes of agents *row* at instants *step* off the road; NaN if absent."""
    return road.off_road_share(corners(tracks.xy_m[row, step], tracks.yaw_rad[row, step], tracks.size_m[row]))
