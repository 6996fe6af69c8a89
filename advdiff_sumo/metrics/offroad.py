"""Leaving the road: the target's collision with the environment, and how far background vehicles leave it.

A vehicle has left the road when more than half its box lies outside the drivable area. Half is chosen because
the share then does not depend on how exactly a net draws its kerbs: a car that cuts a corner or keeps 0.3 m too
far right stays far below it, while a car whose centre line has left the road is over it.
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
#: Background vehicles are looked at this often: the step of the models that move them.
BACKGROUND_EVERY_S = 0.5


@dataclass(frozen=True)
class OffRoad:
    """The target leaves the road.

    Attributes:
        step: instant before it.
        time_s: when, since the episode's start, between instants by linear interpolation of the share.
        xy_m: (2,) centre of the target's box at that time.
        speed_mps: speed at that time.
    """

    step: int
    time_s: float
    xy_m: FloatArray
    speed_mps: float


@dataclass(frozen=True)
class BackgroundOffRoad:
    """How background vehicles that a policy moved left the road, beyond what they did at their start.

    Attributes:
        mean_share: mean over vehicles and instants of the added share of the box off the road; None: no vehicle.
        max_share: greatest added share; None: no vehicle.
        rows: of the tracks, those that added more than ``OFF_ROAD_SHARE``.
    """

    mean_share: float | None
    max_share: float | None
    rows: tuple[int, ...] = ()

    @property
    def vehicles(self) -> int:
        """How many left the road."""
        return len(self.rows)


def target_leaves_road(record: EpisodeRecord, road: RoadMap) -> OffRoad | None:
    """Return when the target first leaves the road, or None.

    A target that starts off the road is not counted until it has been on it. Whoever walks or cycles may go there.
    """
    tracks, row = record.tracks, record.target
    if tracks.classes[row] not in MOTOR_CLASSES:
        return None
    share = shares(road, tracks, np.full(tracks.steps, row), np.arange(tracks.steps))
    off = share > OFF_ROAD_SHARE
    crossing = np.flatnonzero(off[1:] & (share[:-1] <= OFF_ROAD_SHARE))
    if not crossing.size:
        return None
    step = int(crossing[0])
    part = float((OFF_ROAD_SHARE - share[step]) / (share[step + 1] - share[step]))
    xy, speed = tracks.xy_m[row, step : step + 2], tracks.speed_mps[row, step : step + 2]
    return OffRoad(
        step=step,
        time_s=tracks.t0_s + (step + part) * tracks.dt_s,
        xy_m=xy[0] + part * (xy[1] - xy[0]),
        speed_mps=float(speed[0] + part * (speed[1] - speed[0])),
    )


def background_off_road(record: EpisodeRecord, road: RoadMap) -> BackgroundOffRoad:
    """Return how far motor vehicles moved by the policy left the road, every ``BACKGROUND_EVERY_S``.

    What a vehicle had off the road when it was first there (a parked car in a log) is taken off.
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
    first = np.argmax(tracks.valid, axis=1)
    begin = np.zeros(tracks.agents)
    rows = np.unique(row)
    begin[rows] = shares(road, tracks, rows, first[rows])
    added = np.maximum(0.0, shares(road, tracks, row, step) - begin[row])
    most = np.zeros(tracks.agents)
    np.maximum.at(most, row, added)
    gone = tuple(np.flatnonzero(most > OFF_ROAD_SHARE).tolist())
    return BackgroundOffRoad(float(added.mean()), float(added.max()), gone)


def shares(road: RoadMap, tracks: Tracks, row: IntArray, step: IntArray) -> FloatArray:
    """Return (N,) the share of the boxes of agents *row* at instants *step* off the road; NaN when absent."""
    return road.off_road_share(corners(tracks.xy_m[row, step], tracks.yaw_rad[row, step], tracks.size_m[row]))
