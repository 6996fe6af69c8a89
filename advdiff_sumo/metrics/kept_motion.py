"""Extrapolate a recorded road user: with its speed kept from some instant on, or beyond the record's end.

Both follow the recorded way, so that a road user in a bend does not go straight on. Beyond the record's end the way
continues with the curvature of its last metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.polylines import stations_m
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.continuous_collision import BoxMotion, first_contact
from advdiff_sumo.metrics.kinematics import velocities
from advdiff_sumo.metrics.safe_gap import RESPONSE_S

#: Decelerations that are tried, the gentlest first. If none avoids a contact, the hardest is the result.
BRAKES_MPS2 = np.arange(0.0, 9.25, 0.25)
#: A way continues beyond the record's end by this.
_BEYOND_M = 250.0
#: Its curvature there is measured over these last metres; it is 0 if fewer than the least were driven.
_CURVATURE_OVER_M, _LEAST_CURVATURE_OVER_M = 5.0, 1.0
_MAX_CURVATURE_1PM = 0.2
#: Braking at the record's end continues at no more than this.
_MAX_BRAKE_MPS2 = 8.0


@dataclass(frozen=True)
class Poses:
    """T instants of a box: centres (T, 2) in m and headings (T,) in rad."""

    xy_m: FloatArray
    yaw_rad: FloatArray

    def __len__(self) -> int:
        return len(self.yaw_rad)


@dataclass(frozen=True)
class DrivenWay:
    """Poses along a recorded drive and beyond its end, by the distance driven; P points.

    Attributes:
        s_m: (P,) distance from its first point, never decreasing.
        xy_m: (P, 2) centres.
        yaw_rad: (P,) headings without jumps of a full turn.
    """

    s_m: FloatArray
    xy_m: FloatArray
    yaw_rad: FloatArray

    @staticmethod
    def of(tracks: Tracks, row: int, start: int) -> DrivenWay:
        """Return the way of *row* from instant *start* on, at which it must be present."""
        absent = np.flatnonzero(~tracks.valid[row])
        begin = int(max(absent[absent < start], default=-1)) + 1
        stop = int(min(absent[absent > start], default=tracks.steps))
        driven_s, driven_yaw = stations_m(tracks.xy_m[row, begin:stop]), tracks.yaw_rad[row, begin:stop]
        xy, yaw = tracks.xy_m[row, start:stop], np.unwrap(driven_yaw[start - begin :])
        s = stations_m(xy)
        beyond_s = np.arange(1.0, _BEYOND_M + 1.0)
        beyond_yaw = yaw[-1] + _last_curvature_1pm(driven_s, driven_yaw) * beyond_s
        sign = -1.0 if tracks.speed_mps[row, stop - 1] < 0.0 else 1.0
        beyond_xy = xy[-1] + np.cumsum(sign * unit(beyond_yaw), axis=0)
        return DrivenWay(
            np.concatenate((s, s[-1] + beyond_s)),
            np.vstack((xy, beyond_xy)),
            np.concatenate((yaw, beyond_yaw)),
        )

    def at(self, s_m: FloatArray) -> Poses:
        """Return the poses at distances *s_m* (T,)."""
        xy = np.stack([np.interp(s_m, self.s_m, self.xy_m[:, axis]) for axis in (0, 1)], axis=-1)
        return Poses(xy, np.interp(s_m, self.s_m, self.yaw_rad))


def _last_curvature_1pm(s_m: FloatArray, yaw_rad: FloatArray) -> float:
    """Return the mean curvature of the last metres; 0 if too few were driven."""
    since = int(np.searchsorted(s_m, s_m[-1] - _CURVATURE_OVER_M))
    driven_m = float(s_m[-1] - s_m[since])
    if driven_m < _LEAST_CURVATURE_OVER_M:
        return 0.0
    curvature = float(wrap_angle(yaw_rad[-1] - yaw_rad[since])) / driven_m
    return float(np.clip(curvature, -_MAX_CURVATURE_1PM, _MAX_CURVATURE_1PM))


def velocity_mps(tracks: Tracks, row: int, step: int) -> FloatArray:
    """Return the velocity (2,) of *row* at instant *step*, from the step before it."""
    return np.asarray(velocities(tracks.window(max(0, step - 1), step + 1))[row, -1])


def with_speed_kept(record: EpisodeRecord, row: int, start: int, since: int, count: int) -> Poses:
    """Return poses of *row*: as recorded from *start* to *since*, then *count* more along its way at its speed then."""
    tracks = record.tracks
    speed = float(np.hypot(*velocity_mps(tracks, row, since)))
    s_m = np.asarray(speed * tracks.dt_s * np.arange(1, count + 1), dtype=np.float64)
    after = DrivenWay.of(tracks, row, since).at(s_m)
    return _joined(tracks, row, slice(start, since + 1), after)


def with_velocity_kept(record: EpisodeRecord, row: int, since: int, count: int) -> Poses:
    """Return poses of *row* at instant *since* and at *count* more, with constant velocity and heading."""
    tracks = record.tracks
    time = tracks.dt_s * np.arange(1, count + 1)[:, None]
    xy = tracks.xy_m[row, since] + time * velocity_mps(tracks, row, since)
    after = Poses(xy, np.full(count, tracks.yaw_rad[row, since]))
    return _joined(tracks, row, slice(since, since + 1), after)


def continued_poses(record: EpisodeRecord, row: int, since: int, count: int) -> Poses:
    """Return poses of *row* at instant *since* and at *count* more: as recorded, then with its last speed or braking.

    NaN where it is absent, also after the record's end if it has left by then.
    """
    tracks = record.tracks
    last = min(tracks.steps - 1, since + count)
    missing = since + count - last
    after = Poses(np.full((missing, 2), np.nan), np.full(missing, np.nan))
    if missing and tracks.valid[row, last]:
        absent = np.flatnonzero(~tracks.valid[row, : last + 1])
        begin = int(absent[-1]) + 1 if absent.size else 0
        way = DrivenWay.of(tracks, row, begin)
        last_s_m = float(way.s_m[last - begin])
        after = way.at(np.asarray(last_s_m + _distances_after_end_m(tracks, row, missing)))
    return _joined(tracks, row, slice(since, last + 1), after)


def _distances_after_end_m(tracks: Tracks, row: int, count: int) -> FloatArray:
    """Return (count,) distances driven after the record's end, with the last braking or else the speed kept."""
    speed = np.abs(tracks.speed_mps[row, -2:])
    speed = speed[np.isfinite(speed)]  # only one if it appeared at the last instant
    braking = float(np.clip((speed[0] - speed[-1]) / tracks.dt_s, 0.0, _MAX_BRAKE_MPS2))
    time = tracks.dt_s * np.arange(1, count + 1)
    if braking > 0.0:
        time = np.minimum(time, speed[-1] / braking)
    return np.asarray(speed[-1] * time - 0.5 * braking * time**2)


def braked_s_m(speed_mps: float, brake_mps2: float, count: int, dt_s: float) -> FloatArray:
    """Return (count,) distances of a driver who keeps the speed for the response time and then brakes to a stop."""
    time = dt_s * np.arange(count)
    braking_s = np.maximum(0.0, time - RESPONSE_S)
    if brake_mps2 > 0.0:
        braking_s = np.minimum(braking_s, speed_mps / brake_mps2)
    response_s = np.minimum(time, RESPONSE_S)
    return np.asarray(speed_mps * (response_s + braking_s) - 0.5 * brake_mps2 * braking_s**2)


def _joined(tracks: Tracks, row: int, recorded: slice, after: Poses) -> Poses:
    return Poses(
        np.vstack((tracks.xy_m[row, recorded], after.xy_m)),
        np.concatenate((tracks.yaw_rad[row, recorded], after.yaw_rad)),
    )


def first_contact_step(a: Poses, b: Poses, a_size_m: FloatArray, b_size_m: FloatArray) -> int | None:
    """Return the instant before the boxes of *a* and *b* (T instants each) first meet; None if they do not.

    Args:
        a: poses of the first box.
        b: poses of the second box.
        a_size_m: (2,) length and width of the first box.
        b_size_m: (2,) length and width of the second box.
    """
    motions = [
        BoxMotion.between(
            x.xy_m[:-1], x.yaw_rad[:-1], x.xy_m[1:], x.yaw_rad[1:], np.broadcast_to(size, (len(x) - 1, 2))
        )
        for x, size in ((a, a_size_m), (b, b_size_m))
    ]
    with np.errstate(invalid="ignore"):
        contacts = np.flatnonzero(~np.isnan(first_contact(*motions)))
    return int(contacts[0]) if contacts.size else None
