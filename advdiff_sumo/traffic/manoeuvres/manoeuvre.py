"""One manoeuvre of one vehicle and the future that comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.traffic.manoeuvres.profiles import (
    CHECK_DT_S,
    CHECK_TIMES_S,
    PLAN_DT_S,
    SpeedProfile,
    drive_profiles,
)
from advdiff_sumo.traffic.manoeuvres.ways import Way, smooth_step

LATERAL_MPS = 1.1
"""Mean lateral speed of a lane change: 3 to 3.5 s for a lane, as people drive (Toledo and Zohar 2007,
doi:10.3141/1999-08, give 1 to 13 s with a mean of 4 to 6)."""
ENTERS_SHARE = 0.35
"""Share of the way across after which a vehicle that changes lanes is over the line, and perceived as intruding."""
_TURNS_MPS = 0.5
_EVERY = round(PLAN_DT_S / CHECK_DT_S)


@dataclass(frozen=True)
class Manoeuvre:
    """What a vehicle does for the next seconds.

    Attributes:
        kind: name, one of ``repertoire.KINDS``.
        row: of the vehicle in the scene.
        way: that it follows.
        profile: its speed.
        goal: the way on another lane that it changes to; None: it stays.
        sets_up: whether it only brings the vehicle into position.
        delay_s: when the change of lanes begins.
        reveals: row of who stands ahead on its way and is seen once it has left; None: nobody.
    """

    kind: str
    row: int
    way: Way
    profile: SpeedProfile = field(default_factory=SpeedProfile)
    goal: Way | None = None
    sets_up: bool = False
    delay_s: float = 0.0
    reveals: int | None = None

    def enters_s(self, xy_m: FloatArray) -> float:
        """Return when the vehicle, which is at *xy_m* (2,) now, enters the lane that it changes to; 0 if it stays."""
        if self.goal is None:
            return 0.0
        return self.delay_s + ENTERS_SHARE * abs(float(self.goal.line.project(xy_m)[1])) / LATERAL_MPS


@dataclass(frozen=True)
class ManoeuvreFutures(KinematicStates):
    """Futures (C, T) of C manoeuvres at ``CHECK_TIMES_S``.

    Attributes:
        driven_m: (C, T) distances along the ways.
    """

    driven_m: FloatArray

    def at_model_steps(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return centres (C, S, 2), headings (C, S) and speeds (C, S) at the instants of a plan alone."""
        at = slice(_EVERY - 1, None, _EVERY)
        return self.xy_m[:, at], self.yaw_rad[:, at], self.speed_mps[:, at]


def futures_of_manoeuvres(manoeuvres: Sequence[Manoeuvre], speed_mps: FloatArray) -> ManoeuvreFutures:
    """Return the futures of *manoeuvres*, whose vehicles drive *speed_mps* (C,) now."""
    driven, speed = drive_profiles(speed_mps, [m.profile for m in manoeuvres])
    xy = np.empty((*driven.shape, 2))
    yaw = np.empty(driven.shape)
    for k, manoeuvre in enumerate(manoeuvres):
        xy[k], yaw[k] = manoeuvre.way.poses(driven[k], CHECK_TIMES_S)
        if manoeuvre.goal is not None:
            xy[k], yaw[k] = _changing(manoeuvre, manoeuvre.goal, driven[k], speed[k], (xy[k], yaw[k]))
    return ManoeuvreFutures(xy, yaw, speed, driven)


def _changing(
    manoeuvre: Manoeuvre,
    goal: Way,
    driven_m: FloatArray,
    speed_mps: FloatArray,
    own: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return centres (T, 2) and headings (T,) of a change from the own way to *goal*."""
    here = manoeuvre.way.line.at(manoeuvre.way.lane.s_m, manoeuvre.way.lane.offset_m)[0]
    begin, across = goal.line.project(here)
    there, along = goal.line.at(float(begin) + driven_m, extrapolate=True)
    since = np.maximum(CHECK_TIMES_S - manoeuvre.delay_s, 0.0)
    share = smooth_step(since * LATERAL_MPS / max(abs(float(across)), 0.3))
    xy = own[0] + share[:, None] * (there - own[0])
    stride = np.gradient(np.vstack((here, xy)), axis=0)[1:]
    moving = speed_mps > _TURNS_MPS
    drift = np.arctan2(stride[:, 1], stride[:, 0])
    return xy, np.where(moving & (np.hypot(*stride.T) > _TURNS_MPS * CHECK_DT_S), drift, along)
