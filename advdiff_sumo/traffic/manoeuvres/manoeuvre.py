"""One manoeuvre of one vehicle, and the future motion that follows from it."""

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
_ENTRY_SHARE = 0.67
"""Share of the distance between two lane centres at which a vehicle that changes lanes counts as intruding: its box is
0.3 m over the line (1.8 m wide, lanes of 3.5 m)."""
_FINE_TIMES_S: FloatArray = 0.05 * np.arange(160.0)
_MIN_CHANGE_M = 0.3  # a lane change takes at least as long as one over this distance
_FULL_LATERAL_FROM_MPS = 4.4
"""At lower speeds the lateral speed falls in proportion: 1 m sideways for 4 m forward, as fast as a bus can do it."""
_MIN_ROLLING_MPS = 0.5  # a slower vehicle has no lateral speed
_CHECKS_PER_STEP = round(PLAN_DT_S / CHECK_DT_S)
_AT_PLAN_STEPS = slice(_CHECKS_PER_STEP - 1, None, _CHECKS_PER_STEP)
"""The instants of a plan among those at which boxes are compared."""


@dataclass(frozen=True)
class SlowBody:
    """The box of a vehicle that changes lanes slowly: its front enters first, and lateral motion needs forward motion.

    Attributes:
        speed_mps: present speed.
        length_m: length of its box.
        width_m: width of its box.
        corridor_half_width_m: half the width of the target, into whose corridor it moves.
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
        row: the vehicle's row in the scene.
        way: the way that it follows.
        profile: its speed over time.
        goal: the way on another lane that it changes to; None: it keeps its lane.
        is_positioning: whether it only brings the vehicle into position.
        delay_s: when the lane change begins.
        revealed_row: row of the vehicle that the target sees only after a cut-out; None: there is none.
        body: box of a vehicle that changes lanes slowly; None: it is fast enough to be treated as a point.
    """

    kind: str
    row: int
    way: Way
    profile: SpeedProfile = field(default_factory=SpeedProfile)
    goal: Way | None = None
    is_positioning: bool = False
    delay_s: float = 0.0
    revealed_row: int | None = None
    body: SlowBody | None = None

    def enters_s(self, xy_m: FloatArray, within_m: float | None = None) -> float:
        """Return when the vehicle enters the lane that it changes to; 0 if it keeps its lane.

        Args:
            xy_m: (2,) its present position.
            within_m: distance from the middle of that lane at which it has entered; None: that of a car.
        """
        if self.goal is None:
            return 0.0
        apart, across = self.goal.line.project(np.stack((self.way.line.at(self.way.lane.s_m)[0], xy_m)))[1]
        if self.body is not None:
            edge_m = 0.5 * self.goal.present_lane.width_m - INTRUSION_M
            return self._first_corner_s(self.body, float(across), edge_m, length_m=self.body.length_m)
        within_m = _ENTRY_SHARE * abs(float(apart)) if within_m is None else within_m
        has_entered = np.abs(self.goal_offsets_m(float(across), _FINE_TIMES_S)) <= within_m
        return self.delay_s + float(_FINE_TIMES_S[np.argmax(has_entered)])

    def _first_corner_s(
        self, body: SlowBody, across_m: float, within_m: float, length_m: float = 0.0
    ) -> float:
        """Return when the first corner of *body*, *across_m* from the middle of the goal lane, is *within_m* of it.

        The box, *length_m* long, turns as it changes lanes; with a length of 0 it is taken as parallel to the lane.
        """
        driven, _ = drive_profiles(np.array([body.speed_mps]), [self.profile])
        driven_m = np.interp(_FINE_TIMES_S, np.append(0.0, CHECK_TIMES_S), np.append(0.0, driven[0]))
        beside = np.abs(self.goal_offsets_m(across_m, self.change_time_s(driven_m, _FINE_TIMES_S)))
        slope = -np.gradient(beside) / np.maximum(np.gradient(driven_m), MIN_STRIDE_M)
        yaw = np.arctan(np.clip(slope, 0.0, 1.0))
        corner_m = beside - 0.5 * (length_m * np.sin(yaw) + body.width_m * np.cos(yaw))
        is_within = corner_m <= within_m
        return float(_FINE_TIMES_S[np.argmax(is_within)]) if is_within.any() else float(_FINE_TIMES_S[-1])

    def mean_and_end_speed(self, time_s: float, speed_mps: float) -> tuple[float, float]:
        """Return the mean speed up to *time_s*, and the speed at *time_s*, of a vehicle at *speed_mps* now.

        Only a vehicle with a ``body`` follows its profile; others are taken to keep their speed.
        """
        if self.body is None or time_s <= 0.0:
            return speed_mps, speed_mps
        driven, speed = drive_profiles(np.array([speed_mps]), [self.profile])
        times = np.append(0.0, CHECK_TIMES_S)
        mean = float(np.interp(time_s, times, np.append(0.0, driven[0]))) / time_s
        return mean, float(np.interp(time_s, times, np.append(speed_mps, speed[0])))

    def change_time_s(self, driven_m: FloatArray, time_s: FloatArray) -> FloatArray:
        """Return (T,) how much of the duration of the lane change has passed at *time_s* (T,), *driven_m* (T,) driven.

        A slow vehicle takes longer: the time counts in proportion to its speed.
        """
        if self.body is None:
            return np.maximum(time_in_motion_s(driven_m, time_s) - self.delay_s, 0.0)
        step = np.diff(time_s, prepend=0.0)
        return np.cumsum(np.minimum(np.diff(driven_m, prepend=0.0) / _FULL_LATERAL_FROM_MPS, step))

    def perceivable_s(self, xy_m: FloatArray) -> float:
        """Return when the target can perceive that it must respond to the vehicle, at *xy_m* (2,) now; 0: now.

        A vehicle that changes lanes is perceived when it has entered, or when it then begins to brake. One that does so
        slowly is perceived when its box, taken as parallel to the lane, is in the target's corridor, as the reference
        driver does.
        """
        if self.body is not None and self.goal is not None:
            across = self.goal.line.project(xy_m)[1]
            return self._first_corner_s(self.body, float(across), self.body.corridor_half_width_m)
        brakes_later = self.profile.then_mps2 < 0.0 <= self.profile.first_mps2
        brakes_s = self.profile.switch_s if self.goal is not None and brakes_later else 0.0
        return max(self.enters_s(xy_m), brakes_s)

    def goal_offsets_m(self, across_m: float, since_s: FloatArray) -> FloatArray:
        """Return offsets (T,) from the goal's line, *since_s* (T,) after a change over *across_m* began."""
        lasts_s = max(abs(across_m), _MIN_CHANGE_M) / LATERAL_MPS
        drift_mps = self.way.drift_mps if self.delay_s == 0.0 else 0.0
        if self.body is not None:
            speed_mps = float(np.clip(self.body.speed_mps, _MIN_ROLLING_MPS, _FULL_LATERAL_FROM_MPS))
            drift_mps *= _FULL_LATERAL_FROM_MPS / speed_mps
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
        return (
            self.xy_m[:, _AT_PLAN_STEPS],
            self.yaw_rad[:, _AT_PLAN_STEPS],
            self.speed_mps[:, _AT_PLAN_STEPS],
        )


def futures_of_manoeuvres(manoeuvres: Sequence[Manoeuvre], speed_mps: FloatArray) -> ManoeuvreFutures:
    """Return the futures of *manoeuvres*, whose vehicles drive at *speed_mps* (C,) now."""
    driven, speed = drive_profiles(speed_mps, [m.profile for m in manoeuvres])
    xy = np.empty((*driven.shape, 2))
    yaw = np.empty(driven.shape)
    for k, manoeuvre in enumerate(manoeuvres):
        xy[k], yaw[k] = manoeuvre.way.poses(driven[k], CHECK_TIMES_S)
        if manoeuvre.goal is not None:
            xy[k], yaw[k] = _change_poses(manoeuvre, manoeuvre.goal, driven[k])
    return ManoeuvreFutures(xy, yaw, speed, driven)


def planned_motions(
    view: SituationView, manoeuvres: Sequence[Manoeuvre]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres (C, S, 2), headings (C, S) and speeds (C, S) at the instants of a plan.

    A vehicle that has not set off yet keeps its exact present pose, also if that is not aligned with its lane.
    """
    rows = [manoeuvre.row for manoeuvre in manoeuvres]
    futures = futures_of_manoeuvres(manoeuvres, np.array([view.speed(row) for row in rows]))
    xy, yaw, speed = futures.at_model_steps()
    stands, history = futures.driven_m[:, _AT_PLAN_STEPS] < MIN_STRIDE_M, view.scene.history
    xy = np.where(stands[..., None], history.xy_m[rows, -1:], xy)
    return xy, np.where(stands, history.yaw_rad[rows, -1:], yaw), speed


def _change_poses(manoeuvre: Manoeuvre, goal: Way, driven_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return centres (T, 2) and headings (T,) of a change from the vehicle's own way to *goal*."""
    way = manoeuvre.way
    start = way.line.at(way.lane.s_m, way.lane.offset_m)[0]
    goal_s, across = goal.line.project(start)
    on_goal, goal_yaw = goal.line.at(float(goal_s) + driven_m, extrapolate=True)
    on_own_lane = way.line.at(way.lane.s_m + driven_m, way.lane.offset_m, extrapolate=True)[0]
    since_s = manoeuvre.change_time_s(driven_m, CHECK_TIMES_S)
    offsets = manoeuvre.goal_offsets_m(float(across), since_s)
    remaining = offsets / across if across else 0.0 * offsets
    xy = on_goal + remaining[:, None] * (on_own_lane - on_goal)
    return xy, course_headings(start, xy, driven_m, goal_yaw)
