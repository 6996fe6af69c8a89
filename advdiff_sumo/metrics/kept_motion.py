"""Where a road user would have been had it kept its speed from some instant on, and where after the record's end.

Both follow the way that the record shows, so that nobody is taken to go straight on out of a bend. Where the record
ends, the way goes on with the turn of its last metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.polylines import stations_m
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.continuous_collision import Sweep, first_contact
from advdiff_sumo.metrics.kinematics import velocities
from advdiff_sumo.metrics.safe_gap import RESPONSE_S

#: Brakings that are tried, the gentlest first; where none avoids a contact, the hardest is the answer.
BRAKES_MPS2 = np.arange(0.0, 9.25, 0.25)
_AHEAD_M = 250.0
_TURN_OVER_M = 5.0
_LEAST_TURN_OVER_M = 1.0
_SHARPEST_TURN_PER_M = 0.2
_HARDEST_BRAKE_MPS2 = 8.0


@dataclass(frozen=True)
class Poses:
    """T instants of a box: centres (T, 2) in m and headings (T,) in rad."""

    xy_m: FloatArray
    yaw_rad: FloatArray

    def __len__(self) -> int:
        return len(self.yaw_rad)


@dataclass(frozen=True)
class DrivenWay:
    """Places along a recorded drive and beyond its end, by the distance driven; P points.

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
        """Return the way of *row* from instant *start* on, where it has to be there."""
        there = tracks.valid[row, start:]
        stop = len(there) if there.all() else int(np.argmin(there))
        xy, yaw = tracks.xy_m[row, start : start + stop], np.unwrap(tracks.yaw_rad[row, start : start + stop])
        s = stations_m(xy)
        after = np.arange(1.0, _AHEAD_M + 1.0)
        heading = yaw[-1] + _last_turn_per_m(s, yaw) * after
        sign = -1.0 if tracks.speed_mps[row, start + stop - 1] < 0.0 else 1.0
        beyond = xy[-1] + np.cumsum(sign * unit(heading), axis=0)
        return DrivenWay(
            np.concatenate((s, s[-1] + after)), np.vstack((xy, beyond)), np.concatenate((yaw, heading))
        )

    def at(self, s_m: FloatArray) -> Poses:
        """Return the poses at distances *s_m* (T,)."""
        xy = np.stack([np.interp(s_m, self.s_m, self.xy_m[:, axis]) for axis in (0, 1)], axis=-1)
        return Poses(xy, np.interp(s_m, self.s_m, self.yaw_rad))


def _last_turn_per_m(s_m: FloatArray, yaw_rad: FloatArray) -> float:
    """Return by how much the heading turned in each of the last metres; 0 where hardly any were driven."""
    since = int(np.searchsorted(s_m, s_m[-1] - _TURN_OVER_M))
    driven = float(s_m[-1] - s_m[since])
    if driven < _LEAST_TURN_OVER_M:
        return 0.0
    turn = float(wrap_angle(yaw_rad[-1] - yaw_rad[since])) / driven
    return float(np.clip(turn, -_SHARPEST_TURN_PER_M, _SHARPEST_TURN_PER_M))


def velocity_mps(tracks: Tracks, row: int, step: int) -> FloatArray:
    """Return the velocity (2,) of *row* at instant *step* in m/s, from the step before it."""
    return np.asarray(velocities(tracks.window(max(0, step - 1), step + 1))[row, -1])


def kept(record: EpisodeRecord, row: int, start: int, since: int, count: int) -> Poses:
    """Return poses of *row*: as recorded from *start* to *since*, then *count* more along its way at its speed then."""
    tracks = record.tracks
    speed = float(np.hypot(*velocity_mps(tracks, row, since)))
    s_m = np.asarray(speed * tracks.dt_s * np.arange(1, count + 1), dtype=np.float64)
    after = DrivenWay.of(tracks, row, since).at(s_m)
    return _joined(tracks, row, slice(start, since + 1), after)


def kept_straight(record: EpisodeRecord, row: int, since: int, count: int) -> Poses:
    """Return poses of *row* at instant *since* and at *count* more, with the velocity and the heading of then."""
    tracks = record.tracks
    after = tracks.dt_s * np.arange(1, count + 1)[:, None]
    xy = tracks.xy_m[row, since] + after * velocity_mps(tracks, row, since)
    poses = Poses(xy, np.full(count, tracks.yaw_rad[row, since]))
    return _joined(tracks, row, slice(since, since + 1), poses)


def gone_on(record: EpisodeRecord, row: int, since: int, count: int) -> Poses:
    """Return poses of *row* at instant *since* and at *count* more: as recorded, then as it last drove or braked.

    NaN where it is absent; who has left by the record's end does not come back.
    """
    tracks = record.tracks
    last = min(tracks.steps - 1, since + count)
    rest = since + count - last
    after = Poses(np.full((rest, 2), np.nan), np.full(rest, np.nan))
    if rest and tracks.valid[row, last]:
        absent = np.flatnonzero(~tracks.valid[row, : last + 1])
        begin = int(absent[-1]) + 1 if absent.size else 0
        way = DrivenWay.of(tracks, row, begin)
        driven = float(way.s_m[last - begin])
        after = way.at(np.asarray(driven + _driven_on_m(tracks, row, rest)))
    return _joined(tracks, row, slice(since, last + 1), after)


def _driven_on_m(tracks: Tracks, row: int, count: int) -> FloatArray:
    """Return (count,) distances driven after the record's end: its last braking is kept, or its speed."""
    speed = np.abs(tracks.speed_mps[row, -2:])
    speed = speed[np.isfinite(speed)]  # who appeared at the last instant has one
    braking = float(np.clip((speed[0] - speed[-1]) / tracks.dt_s, 0.0, _HARDEST_BRAKE_MPS2))
    time = tracks.dt_s * np.arange(1, count + 1)
    if braking > 0.0:
        time = np.minimum(time, speed[-1] / braking)
    return np.asarray(speed[-1] * time - 0.5 * braking * time**2)


def braked_s_m(speed_mps: float, brake_mps2: float, count: int, dt_s: float) -> FloatArray:
    """Return (count,) distances of a driver who goes on for the response time and then brakes evenly to a stop."""
    time = dt_s * np.arange(count)
    braking = np.maximum(0.0, time - RESPONSE_S)
    if brake_mps2 > 0.0:
        braking = np.minimum(braking, speed_mps / brake_mps2)
    held = np.minimum(time, RESPONSE_S)
    return np.asarray(speed_mps * (held + braking) - 0.5 * brake_mps2 * braking**2)


def _joined(tracks: Tracks, row: int, recorded: slice, after: Poses) -> Poses:
    return Poses(
        np.vstack((tracks.xy_m[row, recorded], after.xy_m)),
        np.concatenate((tracks.yaw_rad[row, recorded], after.yaw_rad)),
    )


def contact_at(a: Poses, b: Poses, a_size_m: FloatArray, b_size_m: FloatArray) -> int | None:
    """Return the instant before the boxes of *a* and *b* (T instants each) first meet; None where they do not.

    Args:
        a: the one.
        b: the other.
        a_size_m: (2,) length and width of the one.
        b_size_m: (2,) those of the other.
    """
    sweeps = [
        Sweep.between(
            x.xy_m[:-1], x.yaw_rad[:-1], x.xy_m[1:], x.yaw_rad[1:], np.broadcast_to(size, (len(x) - 1, 2))
        )
        for x, size in ((a, a_size_m), (b, b_size_m))
    ]
    with np.errstate(invalid="ignore"):
        met = np.flatnonzero(~np.isnan(first_contact(*sweeps)))
    return int(met[0]) if met.size else None
