"""One manoeuvre of one vehicle and the future that comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.kinematic_states import KinematicStates
from advdiff_sumo.metrics.lane_entry import INTRUSION_M
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import (
    CHECK_DT_S,
    CHECK_TIMES_S,
    PLAN_DT_S,
    SpeedProfile,
    drive_profiles,
)
from advdiff_sumo.traffic.manoeuvres.ways import (
    MIN_STRIDE_M,
    Way,
    course_headings,
    settling_offsets_m,
    time_in_motion_s,
)

LATERAL_MPS = 1.1
"""Mean lateral speed of a lane change: 3 to 3.5 s for a lane, as people drive (Toledo and Zohar 2007,
doi:10.3141/1999-08, give 1 to 13 s with a mean of 4 to 6)."""
_ENTERS_SHARE = 0.67
"""Share of the distance between the lanes' centres at which a vehicle that changes between them is 0.3 m over the line
(1.8 m wide, lanes of 3.5 m), and perceived as intruding."""
_FINE_S: FloatArray = 0.05 * np.arange(160.0)
_NARROW_M = 0.3
_ASIDE_FROM_MPS = 4.4
"""Who drives more slowly gets aside more slowly, by a metre in four that it drives; no bus does so faster."""
_ROLLS_MPS = 0.5
"""Who is slower does not drift."""
_EVERY = round(PLAN_DT_S / CHECK_DT_S)
_OF_A_PLAN = slice(_EVERY - 1, None, _EVERY)
"""The instants of a plan among those at which boxes are compared."""


@dataclass(frozen=True)
class SlowBody:
    """Who changes lanes slowly: its front comes first, and it gets aside no faster than it drives on.

    Attributes:
        speed_mps: now.
        length_m: of its box.
        width_m: of its box.
        corridor_m: half the width of the target, whose corridor it comes into.
    """

    speed_mps: float
    length_m: float
    width_m: float
    corridor_half_width_m: float


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
        body: of who changes lanes slowly; None: it is fast enough to take it for a point.
    """

    kind: str
    row: int
    way: Way
    profile: SpeedProfile = field(default_factory=SpeedProfile)
    goal: Way | None = None
    sets_up: bool = False
    delay_s: float = 0.0
    revealed_row: int | None = None
    body: SlowBody | None = None

    def enters_s(self, xy_m: FloatArray, within_m: float | None = None) -> float:
        """Return when the vehicle enters the lane that it changes to; 0 if it stays.

        Args:
            xy_m: (2,) where it is now.
            within_m: from the middle of that lane it has entered it; None: as a car enters it.
        """
        if self.goal is None:
            return 0.0
        apart, across = self.goal.line.project(np.stack((self.way.line.at(self.way.lane.s_m)[0], xy_m)))[1]
        if self.body is not None:
            edge_m = 0.5 * self.goal.present_lane.width_m - INTRUSION_M
            return self._reaches_s(self.body, float(across), edge_m, nose_m=self.body.length_m)
        within_m = _ENTERS_SHARE * abs(float(apart)) if within_m is None else within_m
        over = np.abs(self.goal_offsets_m(float(across), _FINE_S)) <= within_m
        return self.delay_s + float(_FINE_S[np.argmax(over)])

    def _reaches_s(self, body: SlowBody, across_m: float, within_m: float, nose_m: float = 0.0) -> float:
        """Return when the first corner of *body* is *within_m* of the middle of the lane that it has *across_m* to.

        The corner is that of a box of length *nose_m*, which is turned into the lane.
        """
        driven, _ = drive_profiles(np.array([body.speed_mps]), [self.profile])
        fine_m = np.interp(_FINE_S, np.append(0.0, CHECK_TIMES_S), np.append(0.0, driven[0]))
        beside = np.abs(self.goal_offsets_m(across_m, self.change_time_s(fine_m, _FINE_S)))
        slope = -np.gradient(beside) / np.maximum(np.gradient(fine_m), MIN_STRIDE_M)
        turned = np.arctan(np.clip(slope, 0.0, 1.0))
        reach = beside - 0.5 * (nose_m * np.sin(turned) + body.width_m * np.cos(turned))
        over = reach <= within_m
        return float(_FINE_S[np.argmax(over)]) if over.any() else float(_FINE_S[-1])

    def mean_and_end_speed(self, time_s: float, speed_mps: float) -> tuple[float, float]:
        """Return the mean speed up to *time_s* and the speed by then of who drives *speed_mps* now."""
        if self.body is None or time_s <= 0.0:
            return speed_mps, speed_mps
        driven, speed = drive_profiles(np.array([speed_mps]), [self.profile])
        times = np.append(0.0, CHECK_TIMES_S)
        mean = float(np.interp(time_s, times, np.append(0.0, driven[0]))) / time_s
        return mean, float(np.interp(time_s, times, np.append(speed_mps, speed[0])))

    def change_time_s(self, driven_m: FloatArray, time_s: FloatArray) -> FloatArray:
        """Return for how long (T,) a change has gone on of who has driven *driven_m* (T,) by *time_s* (T,).

        Who is slow takes longer: its time goes by as slowly as it drives on.
        """
        if self.body is None:
            return np.maximum(time_in_motion_s(driven_m, time_s) - self.delay_s, 0.0)
        step = np.diff(time_s, prepend=0.0)
        return np.cumsum(np.minimum(np.diff(driven_m, prepend=0.0) / _ASIDE_FROM_MPS, step))

    def perceivable_s(self, xy_m: FloatArray) -> float:
        """Return when the target can perceive that the vehicle, at *xy_m* (2,) now, asks something of it; 0: now.

        Who changes into its lane asks nothing before it is there and, where it means to slow, slows; who does so slowly
        asks nothing before its box, taken as along the lane, is in the target's corridor: there the reference driver
        perceives it.
        """
        if self.body is not None and self.goal is not None:
            across = self.goal.line.project(xy_m)[1]
            return self._reaches_s(self.body, float(across), self.body.corridor_half_width_m)
        slows_later = self.profile.then_mps2 < 0.0 <= self.profile.first_mps2
        slows_s = self.profile.switch_s if self.goal is not None and slows_later else 0.0
        return max(self.enters_s(xy_m), slows_s)

    def goal_offsets_m(self, across_m: float, since_s: FloatArray) -> FloatArray:
        """Return offsets (T,) from the goal's line, *since_s* (T,) after a change began that has *across_m* to go."""
        lasts_s = max(abs(across_m), _NARROW_M) / LATERAL_MPS
        drift_mps = self.way.drift_mps if self.delay_s == 0.0 else 0.0
        if self.body is not None:
            drift_mps *= _ASIDE_FROM_MPS / float(np.clip(self.body.speed_mps, _ROLLS_MPS, _ASIDE_FROM_MPS))
        return settling_offsets_m(across_m, drift_mps, since_s, lasts_s)


@dataclass(frozen=True)
class ManoeuvreFutures(KinematicStates):
    """Futures (C, T) of C manoeuvres at ``CHECK_TIMES_S``.

    Attributes:
        driven_m: (C, T) distances along the ways.
    """

    driven_m: FloatArray

    def at_model_steps(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return centres (C, S, 2), headings (C, S) and speeds (C, S) at the instants of a plan alone."""
        return self.xy_m[:, _OF_A_PLAN], self.yaw_rad[:, _OF_A_PLAN], self.speed_mps[:, _OF_A_PLAN]


def futures_of_manoeuvres(manoeuvres: Sequence[Manoeuvre], speed_mps: FloatArray) -> ManoeuvreFutures:
    """Return the futures of *manoeuvres*, whose vehicles drive *speed_mps* (C,) now."""
    driven, speed = drive_profiles(speed_mps, [m.profile for m in manoeuvres])
    xy = np.empty((*driven.shape, 2))
    yaw = np.empty(driven.shape)
    for k, manoeuvre in enumerate(manoeuvres):
        xy[k], yaw[k] = manoeuvre.way.poses(driven[k], CHECK_TIMES_S)
        if manoeuvre.goal is not None:
            xy[k], yaw[k] = _changing(manoeuvre, manoeuvre.goal, driven[k])
    return ManoeuvreFutures(xy, yaw, speed, driven)


def planned_motions(
    view: SituationView, manoeuvres: Sequence[Manoeuvre]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres (C, S, 2), headings (C, S) and speeds (C, S) at the instants of a plan.

    Who has not set off yet is exactly where it is now, askew or not.
    """
    rows = [manoeuvre.row for manoeuvre in manoeuvres]
    futures = futures_of_manoeuvres(manoeuvres, np.array([view.speed(row) for row in rows]))
    xy, yaw, speed = futures.at_model_steps()
    still, now = futures.driven_m[:, _OF_A_PLAN] < MIN_STRIDE_M, view.scene.history
    xy = np.where(still[..., None], now.xy_m[rows, -1:], xy)
    return xy, np.where(still, now.yaw_rad[rows, -1:], yaw), speed


def _changing(manoeuvre: Manoeuvre, goal: Way, driven_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return centres (T, 2) and headings (T,) of a change from the own way to *goal*."""
    way = manoeuvre.way
    here = way.line.at(way.lane.s_m, way.lane.offset_m)[0]
    begin, across = goal.line.project(here)
    there, along = goal.line.at(float(begin) + driven_m, extrapolate=True)
    beside = way.line.at(way.lane.s_m + driven_m, way.lane.offset_m, extrapolate=True)[0]
    since_s = manoeuvre.change_time_s(driven_m, CHECK_TIMES_S)
    left = manoeuvre.goal_offsets_m(float(across), since_s)
    xy = there + (left / across if across else 0.0 * left)[:, None] * (beside - there)
    return xy, course_headings(here, xy, driven_m, along)
