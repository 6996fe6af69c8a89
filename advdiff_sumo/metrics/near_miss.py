"""Critical near misses: a careful driver would have had to brake hard, and who resolved it.

An encounter without contact is critical when a reference driver in the target's place, who reacts in the
regulation's 0.75 s and then brakes evenly, would have had to brake at more than 4 m/s² for the boxes not to meet.
It takes over where the careful and competent driver would. The other is taken to move as recorded up to the instant
of the least time to collision, and to keep its velocity from there on: what it did to get out of the way afterwards
nobody could rely on.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches.striking_rules import EXPECTED_BRAKE_MPS2
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.continuous_collision import Sweep, first_contact
from advdiff_sumo.metrics.criticality import Extreme
from advdiff_sumo.metrics.kinematics import velocities
from advdiff_sumo.metrics.reference import ReferenceDrive, ReferenceDrivers
from advdiff_sumo.metrics.safe_gap import RESPONSE_S

#: A near miss is looked at where the least time to collision is below this.
NEAR_MISS_TTC_S = 2.5
#: The hardest braking that is asked for; where it does not do, this is the answer.
HARDEST_BRAKE_MPS2 = 9.0
_AFTER_S = 4.0
_BRAKE_STEP_MPS2 = 0.25
_AHEAD_M = 100.0


class ResolvedBy(StrEnum):
    """Who kept a near miss from becoming a collision."""

    TARGET = "target"
    OTHER = "other"
    BOTH = "both"


@dataclass(frozen=True)
class NearMiss:
    """An encounter without contact.

    Attributes:
        row: the other.
        time_s: instant of the least time to collision, since the episode's start.
        brake_mps2: how hard a reference driver would have had to brake; 0 where it needed not.
        resolved_by: who acted so that it did not come to a contact.
    """

    row: int
    time_s: float
    brake_mps2: float
    resolved_by: ResolvedBy

    @property
    def critical(self) -> bool:
        """Whether that is more than one may be expected to brake."""
        return self.brake_mps2 > EXPECTED_BRAKE_MPS2


def near_miss(record: EpisodeRecord, road: RoadMap, ttc: Extreme | None) -> NearMiss | None:
    """Return the near miss at the least time to collision of an episode without one; None where nothing came near.

    Args:
        record: the episode, in which the target did not collide.
        road: its map.
        ttc: its least time to collision (:func:`~advdiff_sumo.metrics.criticality.least`).
    """
    if ttc is None or ttc.value >= NEAR_MISS_TTC_S:
        return None
    step = _step_of(record, ttc)
    drive = careful_drive(record, road, ttc)
    if drive is None:
        return None
    start = drive.takeover_step
    way = _driven_way(record, start)
    kept = _kept_velocity(record, ttc.row, start, step)
    brake = _needed_brake_mps2(record, way, start, ttc.row, kept)
    return NearMiss(ttc.row, ttc.time_s, brake, _resolved_by(record, ttc.row, step))


def careful_drive(record: EpisodeRecord, road: RoadMap, ttc: Extreme) -> ReferenceDrive | None:
    """Return what the careful and competent driver would have done in the encounter of *ttc*; None at the start."""
    step = _step_of(record, ttc)
    if step == 0 or not record.tracks.valid[record.target, : step + 1].all():
        return None
    return ReferenceDrivers(record, road, _closest(record, ttc.row, step)).drive()


def _step_of(record: EpisodeRecord, ttc: Extreme) -> int:
    return round((ttc.time_s - record.tracks.t0_s) / record.tracks.dt_s)


def _closest(record: EpisodeRecord, row: int, step: int) -> Collision:
    """Return what :class:`ReferenceDrivers` takes for the encounter: who, and when it was closest."""
    tracks, rows = record.tracks, [record.target, row]
    offset = tracks.xy_m[row, step] - tracks.xy_m[record.target, step]
    return Collision(
        rows=(record.target, row),
        step=step,
        fraction=0.0,
        time_s=tracks.t0_s + step * tracks.dt_s,
        point_m=tracks.xy_m[record.target, step] + 0.5 * offset,
        penetration_m=0.0,
        initial=False,
        xy_m=tracks.xy_m[rows, step],
        yaw_rad=tracks.yaw_rad[rows, step],
        velocity_mps=velocities(tracks.window(max(0, step - 1), step + 1))[rows, -1],
        normal=offset / max(float(np.hypot(*offset)), 1e-9),
        faces=("front", "rear"),
    )


def _driven_way(record: EpisodeRecord, start: int) -> Polyline:
    """Return the target's driven path from instant *start* on, and straight on from its end."""
    tracks, target = record.tracks, record.target
    xy = tracks.xy_m[target, start:]
    xy = xy[np.isfinite(xy).all(axis=1)]
    last = int(np.flatnonzero(tracks.valid[target])[-1])
    yaw = float(tracks.yaw_rad[target, last])
    kept = [xy[0]]
    for point in xy[1:]:
        if np.hypot(*(point - kept[-1])) > 0.05:  # noise of standing has no direction
            kept.append(point)
    return Polyline.of(np.array([*kept, xy[-1] + _AHEAD_M * np.array((np.cos(yaw), np.sin(yaw)))]))


def _kept_velocity(record: EpisodeRecord, row: int, start: int, since: int) -> tuple[FloatArray, FloatArray]:
    """Return (T, 2) places and (T,) headings of *row* from *start* on: at constant velocity from *since* on."""
    tracks = record.tracks
    velocity = velocities(tracks.window(max(0, since - 1), since + 1))[row, -1]
    after = np.arange(1, round(_AFTER_S / tracks.dt_s) + 1)[:, None] * tracks.dt_s
    xy = np.vstack((tracks.xy_m[row, start : since + 1], tracks.xy_m[row, since] + after * velocity))
    yaw = np.concatenate(
        (tracks.yaw_rad[row, start : since + 1], np.full(len(after), tracks.yaw_rad[row, since]))
    )
    return xy, yaw


def _needed_brake_mps2(
    record: EpisodeRecord, way: Polyline, start: int, row: int, other: tuple[FloatArray, FloatArray]
) -> float:
    """Return the least even braking after the response with which the boxes do not meet."""
    speed = float(record.tracks.speed_mps[record.target, start])
    for brake in np.arange(0.0, HARDEST_BRAKE_MPS2, _BRAKE_STEP_MPS2):
        if not _meets(
            record, way, _braked_s_m(speed, float(brake), len(other[0]), record.tracks.dt_s), row, other
        ):
            return float(brake)
    return HARDEST_BRAKE_MPS2


def _braked_s_m(speed_mps: float, brake_mps2: float, count: int, dt_s: float) -> FloatArray:
    """Return (T,) distances of a driver who goes on for the response time and then brakes evenly to a stop."""
    time = dt_s * np.arange(count)
    braking = np.maximum(0.0, time - RESPONSE_S)
    if brake_mps2 > 0.0:
        braking = np.minimum(braking, speed_mps / brake_mps2)
    held = np.minimum(time, RESPONSE_S)
    return np.asarray(speed_mps * (held + braking) - 0.5 * brake_mps2 * braking**2)


def _meets(
    record: EpisodeRecord, way: Polyline, s_m: FloatArray, row: int, other: tuple[FloatArray, FloatArray]
) -> bool:
    """Return whether the target's box at places *s_m* (T,) of *way* meets that of *row*."""
    xy, yaw = way.at(s_m, extrapolate=True)
    size = record.tracks.size_m
    count = len(s_m) - 1
    own = Sweep.between(xy[:-1], yaw[:-1], xy[1:], yaw[1:], np.broadcast_to(size[record.target], (count, 2)))
    theirs = Sweep.between(
        other[0][:-1], other[1][:-1], other[0][1:], other[1][1:], np.broadcast_to(size[row], (count, 2))
    )
    return not bool(np.isnan(first_contact(own, theirs)).all())


def _resolved_by(record: EpisodeRecord, row: int, step: int) -> ResolvedBy:
    """Return whose doing it was: had one alone kept its velocity from *step* on, would the boxes have met?"""
    target = record.target
    without_target = _meet_if_kept(record, target, row, step)
    without_other = _meet_if_kept(record, row, target, step)
    if without_target != without_other:
        return ResolvedBy.TARGET if without_target else ResolvedBy.OTHER
    return ResolvedBy.BOTH


def _meet_if_kept(record: EpisodeRecord, keeping: int, moving: int, step: int) -> bool:
    """Return whether *keeping*, at constant velocity from *step* on, would have met *moving* as recorded."""
    tracks = record.tracks
    xy, yaw = _kept_velocity(record, keeping, step, step)
    count = min(len(xy), tracks.steps - step) - 1
    if count < 1:
        return False
    span, after = slice(step, step + count), slice(step + 1, step + count + 1)
    sizes = [np.broadcast_to(tracks.size_m[r], (count, 2)) for r in (keeping, moving)]
    own = Sweep.between(xy[:count], yaw[:count], xy[1 : count + 1], yaw[1 : count + 1], sizes[0])
    theirs = Sweep.between(
        tracks.xy_m[moving, span],
        tracks.yaw_rad[moving, span],
        tracks.xy_m[moving, after],
        tracks.yaw_rad[moving, after],
        sizes[1],
    )
    with np.errstate(invalid="ignore"):
        return not bool(np.isnan(first_contact(own, theirs)).all())
