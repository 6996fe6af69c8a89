"""What vehicles would drive that simply follow their lanes, many of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.bicycle import Limits, step, wheelbase_m
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.polylines import kept_points
from advdiff_sumo.traffic.diffusion.lanes_ahead import LaneAhead

_LOOK_AHEAD_S, _MIN_LOOK_AHEAD_M = 0.8, 4.0
_ACCEL_MPS2, _BRAKE_MPS2, _LATERAL_MPS2 = 1.5, 2.5, 2.0
_SUBSTEPS = 2
_EVERY_M, _REACH_M = 0.5, 160.0
_APART_M = 1e5  # longer than any line; keeps one line's arc lengths apart from the next one's


def follow(
    lanes: Sequence[LaneAhead],
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    length_m: FloatArray,
    steps: int,
    dt_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return states (V, T, 2), (V, T), (V, T) of V vehicles that follow their lanes at the limit, slower in bends.

    Pure pursuit through the bicycle model; other vehicles and signals are the business of ``braking``.

    Args:
        lanes: of each vehicle.
        xy_m: (V, 2) centres.
        yaw_rad: (V,) headings.
        speed_mps: (V,) speeds.
        length_m: (V,) lengths.
        steps: T.
        dt_s: spacing.
    """
    limits, small = Limits(), dt_s / _SUBSTEPS
    steep = np.tan(limits.steer_rad) / wheelbase_m(length_m)
    limit = np.array([lane.speed_mps for lane in lanes])
    lines = _Lines.of(lanes)
    xy, yaw, speed, s = xy_m, yaw_rad, np.maximum(speed_mps, 0.0), np.zeros(len(lanes))
    out = []
    for k in range(steps * _SUBSTEPS):
        accel, bend = _pursue(lines, limit, s, (xy, yaw, speed))
        bound = np.minimum(steep, limits.lateral_mps2 / np.square(np.maximum(speed, 0.1)))
        bend = np.minimum(np.maximum(bend, -bound), bound)
        s = s + speed * small
        xy, yaw, speed = step(xy, yaw, speed, accel, bend, small)
        if (k + 1) % _SUBSTEPS == 0:
            out.append((xy, yaw, speed))
    return (
        np.stack([o[0] for o in out], axis=1),
        np.stack([o[1] for o in out], axis=1),
        np.stack([o[2] for o in out], axis=1),
    )


@dataclass(frozen=True)
class _Lines:
    """Centre lines of V vehicles' lanes, one after the other; F segments in all.

    Attributes:
        xy_m: (F, 2) beginnings of the segments.
        tangent: (F, 2) unit vectors along them.
        yaw_rad: (F,) headings.
        s_m: (F,) arc lengths where they begin.
        key_m: (F,) the same, each line's ``_APART_M`` beyond the one before.
        first: (V,) segment that each line begins with.
        last: (V,) and ends with.
        begin_m: (V,) arc length of each vehicle.
    """

    xy_m: FloatArray
    tangent: FloatArray
    yaw_rad: FloatArray
    s_m: FloatArray
    key_m: FloatArray
    first: IntArray
    last: IntArray
    begin_m: FloatArray

    @staticmethod
    def of(lanes: Sequence[LaneAhead]) -> _Lines:
        """Return the lines of vehicles on *lanes*."""
        parts = [x.centre_xy_m for lane in lanes for x in lane.lanes]
        points = np.concatenate(parts)
        pieces = np.array([len(lane.lanes) for lane in lanes])
        counts = np.array([len(part) for part in parts])
        line = np.repeat(np.repeat(np.arange(len(lanes)), pieces), counts)
        keep = kept_points(points) | (np.diff(line, prepend=-1) > 0)  # a line keeps its first point
        points, line = points[keep], line[keep]
        within = line[1:] == line[:-1]
        delta = (points[1:] - points[:-1])[within]
        length = np.hypot(delta[:, 0], delta[:, 1])
        owner = line[:-1][within]
        first = np.searchsorted(owner, np.arange(len(lanes)))
        last = np.searchsorted(owner, np.arange(len(lanes)), side="right") - 1
        # line by line: the same vehicle among others gets the same numbers
        s = np.concatenate([np.cumsum(part) - part for part in np.split(length, first[1:])])
        tangent = delta / length[:, None]
        yaw = np.arctan2(tangent[:, 1], tangent[:, 0])
        begin = np.array([lane.s_m for lane in lanes])
        return _Lines(points[:-1][within], tangent, yaw, s, s + _APART_M * owner, first, last, begin)

    def segment(self, ahead_m: FloatArray) -> IntArray:
        """Return the segment (V,) that each vehicle reaches after *ahead_m* (V,)."""
        key = self.begin_m + ahead_m + _APART_M * np.arange(len(ahead_m))
        found = np.searchsorted(self.key_m, key, side="right") - 1
        return np.asarray(np.minimum(np.maximum(found, self.first), self.last), dtype=np.int64)

    def point(self, ahead_m: FloatArray) -> FloatArray:
        """Return the points (V, 2) that lie *ahead_m* (V,) of each vehicle; the end segments go on."""
        at = self.segment(ahead_m)
        return np.asarray(self.xy_m[at] + (self.begin_m + ahead_m - self.s_m[at])[:, None] * self.tangent[at])


def _pursue(
    lines: _Lines, limit_mps: FloatArray, s_m: FloatArray, state: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return accelerations and curvatures (V,) towards the lanes' centres at their limits."""
    xy, yaw, speed = state
    look = np.maximum(_MIN_LOOK_AHEAD_M, _LOOK_AHEAD_S * speed)
    delta = lines.point(_snapped(s_m + look)) - xy
    angle = wrap_angle(np.arctan2(delta[:, 1], delta[:, 0]) - yaw)
    bend = 2.0 * np.sin(angle) / np.maximum(np.hypot(delta[:, 0], delta[:, 1]), 1.0)
    far = lines.yaw_rad[lines.segment(_snapped(s_m + 2.0 * look))]
    turn = np.abs(wrap_angle(far - yaw)) / (2.0 * look)
    wanted = np.minimum(limit_mps, np.sqrt(_LATERAL_MPS2 / np.maximum(turn, 1e-3)))
    return np.minimum(np.maximum(wanted - speed, -_BRAKE_MPS2), _ACCEL_MPS2), bend


def _snapped(s_m: FloatArray) -> FloatArray:
    """Return *s_m* (V,) on a grid, within reach."""
    return np.asarray(_EVERY_M * np.minimum(np.rint(s_m / _EVERY_M), _REACH_M / _EVERY_M - 1.0))
