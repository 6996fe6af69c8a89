"""Build smooth reference lines along chains of lanes, sampled evenly so that look-ups are array indexing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.maps import Link, RoadMap
from advdiff_sumo.planners.lane_graph.chains import Changes, required_changes

SPACING_M = 1.0
_SMOOTHING = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9.0
_EXTRA_POINTS = 4  # sampled beyond each end, for the smoothing
_MAX_CURVATURE_1PM = 0.17  # a car of 5 m can turn at 0.23; the rest is for steering back
_MAX_ROUNDINGS = 100
# Swinging out before a tight corner. A car has 0.6 m to the edges of a lane.
_SWING_MIN_CUT_M = 0.4  # only if rounding cuts the corner by more
_SWING_PER_CUT, _MAX_SWING_M = 0.7, 0.5
_SWING_LEAD = 9  # the swing is so much before the corner; after it the line is the usual one
_SWING_KERNEL = np.exp(-0.5 * (np.arange(-15, 16) / 7.0) ** 2)
_PADDING_M = 1e7  # coordinates that no point is near to


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """A reference line of P points, ``SPACING_M`` apart.

    Attributes:
        lanes: lane ids in driving order, internal ones included; () for a line that follows no lane.
        lane_start_m: arc length at which each lane begins.
        links: connections over junctions along the path.
        stop_m: arc length of each link's stop line.
        exit_m: arc length at which the lane beyond each link begins.
        length_m: total length.
        xy_m: (P, 2) points.
        yaw_rad: (P,) unwrapped headings.
        curvature_1pm: (P,) left positive.
        limit_mps: (P,) speed limit.
    """

    lanes: tuple[str, ...]
    lane_start_m: FloatArray
    links: tuple[Link, ...]
    stop_m: tuple[float, ...]
    exit_m: tuple[float, ...]
    length_m: float
    xy_m: FloatArray
    yaw_rad: FloatArray
    curvature_1pm: FloatArray
    limit_mps: FloatArray

    @cached_property
    def bend_mps(self) -> FloatArray:
        """(P,) speed at which the lateral acceleration is 1 m/s²; for a m/s², multiply by √a."""
        return np.asarray(1.0 / np.sqrt(np.maximum(np.abs(self.curvature_1pm), 1e-4)))

    @cached_property
    def squared_m2(self) -> FloatArray:
        """(P,) squared distances of the points from the origin."""
        return np.asarray((self.xy_m**2).sum(-1))

    def at(self, s_m: FloatArray, d_m: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return points (…, 2) and headings (…,) at *s_m*, *d_m* to the left; straight beyond the ends."""
        cell, fraction = self._cell(s_m)
        begin, yaw = self.xy_m[cell], self._interpolated(self.yaw_rad, cell, fraction)
        xy = begin + fraction[..., None] * (self.xy_m[cell + 1] - begin)
        normal = np.empty(xy.shape)
        normal[..., 0], normal[..., 1] = -np.sin(yaw), np.cos(yaw)
        return xy + np.asarray(d_m)[..., None] * normal, yaw

    def yaw_at(self, s_m: FloatArray) -> FloatArray:
        """Return the headings (…,) at *s_m*, as :meth:`at` does."""
        return self._interpolated(self.yaw_rad, *self._cell(s_m))

    def curvature_at(self, s_m: FloatArray) -> FloatArray:
        """Return the curvature (…,) at *s_m*."""
        return self._interpolated(self.curvature_1pm, *self._cell(s_m))

    def project(
        self, xy_m: FloatArray, window_m: tuple[float, float] = (0.0, np.inf)
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``s`` and ``d`` (…,) of points (…, 2); straight beyond the ends of *window_m* (arc lengths)."""
        flat = xy_m.reshape(-1, 2)
        first = int(min(max(window_m[0] / SPACING_M, 0), len(self.xy_m) - 2))
        window = slice(first, int(min(window_m[1] / SPACING_M, len(self.xy_m))) + 2)
        squared = 2.0 * flat @ self.xy_m[window].T
        np.subtract(
            self.squared_m2[window], squared, out=squared
        )  # (N, P) squared distances, up to a constant in each row
        nearest = first + np.argmin(squared, axis=-1)
        delta = flat - self.xy_m[nearest]
        cos, sin = np.cos(self.yaw_rad[nearest]), np.sin(self.yaw_rad[nearest])
        s = nearest * SPACING_M + cos * delta[:, 0] + sin * delta[:, 1]
        d = cos * delta[:, 1] - sin * delta[:, 0]
        return s.reshape(xy_m.shape[:-1]), d.reshape(xy_m.shape[:-1])

    def lane_at(self, s_m: float) -> int:
        """Return the index in :attr:`lanes` of the lane at *s_m*."""
        lane = int(np.searchsorted(self.lane_start_m, s_m, side="right")) - 1
        return min(max(lane, 0), len(self.lanes) - 1)

    def _interpolated(self, values: FloatArray, cell: IntArray, fraction: FloatArray) -> FloatArray:
        """Interpolate *values* (P,) from points *cell* to the next ones; *fraction* (…,) is clipped to [0, 1]."""
        begin, clipped = values[cell], np.minimum(np.maximum(fraction, 0.0), 1.0)
        return np.asarray(begin + clipped * (values[cell + 1] - begin))

    def _cell(self, s_m: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the index (…,) of the point before each *s_m*, and the fraction of the spacing beyond it."""
        scaled = np.asarray(s_m, dtype=np.float64) / SPACING_M
        cell = np.minimum(np.maximum(scaled, 0.0).astype(np.int64), len(self.xy_m) - 2)
        return cell, scaled - cell


def slowed_ahead(bound_mps: FloatArray, braking_mps2: float, least_mps: float) -> FloatArray:
    """Return speeds (P,) at points ``SPACING_M`` apart that meet *bound_mps* (P,) with *braking_mps2* ahead of it.

    The least of them is *least_mps*.
    """
    # v²(s) ≤ v²(s') + 2 b (s' − s) for every s' ahead: the running minimum of v² + 2 b s from the far end
    braking = 2.0 * braking_mps2 * SPACING_M * np.arange(len(bound_mps))
    squared = np.minimum.accumulate((bound_mps**2 + braking)[::-1])[::-1] - braking
    return np.asarray(np.sqrt(np.maximum(squared, least_mps**2)))


class PathStack:
    """N reference lines in one padded array, for look-ups on all of them at once."""

    def __init__(self, paths: Sequence[ReferencePath]) -> None:
        self.count = np.array([len(path.xy_m) for path in paths], dtype=np.int64)
        longest = int(self.count.max(initial=2))
        self.xy_m = np.full((len(paths), longest, 2), _PADDING_M)
        self.yaw_rad = np.zeros((len(paths), longest))
        self.squared_m2 = np.full((len(paths), longest), 2.0 * _PADDING_M**2)
        for n, path in enumerate(paths):
            self.xy_m[n, : self.count[n]], self.yaw_rad[n, : self.count[n]] = path.xy_m, path.yaw_rad
            self.squared_m2[n, : self.count[n]] = path.squared_m2

    def at(self, s_m: FloatArray, d_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (N, T, 2) and headings (N, T) at *s_m* (N, T), *d_m* (N, T) to the left."""
        rows = np.arange(len(self.count))[:, None]
        scaled = s_m / SPACING_M
        cell = np.minimum(np.maximum(scaled, 0.0).astype(np.int64), self.count[:, None] - 2)
        fraction = scaled - cell
        begin, end = self.xy_m[rows, cell], self.xy_m[rows, cell + 1]
        yaw = self.yaw_rad[rows, cell]
        yaw = yaw + np.minimum(np.maximum(fraction, 0.0), 1.0) * (self.yaw_rad[rows, cell + 1] - yaw)
        normal = np.stack((-np.sin(yaw), np.cos(yaw)), -1)
        return begin + fraction[..., None] * (end - begin) + d_m[..., None] * normal, yaw

    def project(self, xy_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ``s`` and ``d`` (N, K) of points (K, 2), or (N, K, 2), on each line; straight beyond the ends."""
        squared = 2.0 * xy_m @ self.xy_m.transpose(0, 2, 1)  # (N, K, P)
        np.subtract(self.squared_m2[:, None], squared, out=squared)
        nearest = np.argmin(squared, axis=-1)
        rows = np.arange(len(self.count))[:, None]
        delta, yaw = xy_m - self.xy_m[rows, nearest], self.yaw_rad[rows, nearest]
        cos, sin = np.cos(yaw), np.sin(yaw)
        s = nearest * SPACING_M + cos * delta[..., 0] + sin * delta[..., 1]
        return s, cos * delta[..., 1] - sin * delta[..., 0]


@dataclass(frozen=True)
class Zone:
    """Conflict area of two links: where vehicles on both come too close; distances count from each stop line.

    Attributes:
        own_m: begin and end along the own link.
        other_m: begin and end along the other link.
        merges: whether both links lead to the same lane.
    """

    own_m: tuple[float, float]
    other_m: tuple[float, float]
    merges: bool


@dataclass(eq=False)
class Geometry:
    """Cache of what is derived from one road map: reference lines, conflict areas and lane changes.

    Attributes:
        road: the map.
        conflicts: conflict areas of pairs of links, filled by :mod:`.conflicts`.
    """

    road: RoadMap
    conflicts: dict[tuple[str, str, str, str], Zone | None] = field(default_factory=dict)
    _changes: dict[tuple[str, ...], Changes] = field(default_factory=dict)
    _paths: dict[tuple[str, ...], ReferencePath] = field(default_factory=dict)

    @staticmethod
    def of(road: RoadMap) -> Geometry:
        """Return an empty cache for *road*."""
        return Geometry(road)

    def changes(self, edges: Sequence[str]) -> Changes:
        """Return the :func:`required_changes` of *edges*."""
        key = tuple(edges)
        if key not in self._changes:
            self._changes[key] = required_changes(self.road, key)
        return self._changes[key]

    def path(self, lanes: Sequence[str], links: Sequence[Link]) -> ReferencePath:
        """Return the reference line along *lanes*, which *links* connect."""
        key = tuple(lanes)
        if key not in self._paths:
            self._paths[key] = _build(self.road, key, tuple(links))
        return self._paths[key]


def straight_path(xy_m: FloatArray, yaw_rad: float, length_m: float) -> ReferencePath:
    """Return a straight reference line that follows no lane and begins at *xy_m* (2,)."""
    s = SPACING_M * np.arange(max(int(length_m / SPACING_M), 2) + 1)
    ahead = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    return ReferencePath(
        lanes=(),
        lane_start_m=np.zeros(0),
        links=(),
        stop_m=(),
        exit_m=(),
        length_m=float(s[-1]),
        xy_m=xy_m + s[:, None] * ahead,
        yaw_rad=np.full(len(s), yaw_rad),
        curvature_1pm=np.zeros(len(s)),
        limit_mps=np.full(len(s), np.inf),
    )


def _build(road: RoadMap, lanes: tuple[str, ...], links: tuple[Link, ...]) -> ReferencePath:
    """Return the reference line along *lanes*; see :class:`ReferencePath`."""
    parts = [road.lanes[lane] for lane in lanes]
    raw = concatenate([part.line for part in parts])
    lengths = np.array([part.line.length_m for part in parts])
    # gaps between lanes are shared out over the lanes
    bounds = np.concatenate(([0.0], np.cumsum(lengths))) * raw.length_m / lengths.sum()
    s = SPACING_M * np.arange(max(int(np.ceil(raw.length_m / SPACING_M)) + 1, 3))
    xy, yaw, curvature = _smoothed(raw, len(s))
    lane_of = np.clip(np.searchsorted(bounds[1:], s, side="right"), 0, len(parts) - 1)
    entries, exits = _link_lanes(lanes, links)
    return ReferencePath(
        lanes=lanes,
        lane_start_m=bounds[:-1],
        links=links,
        stop_m=tuple(float(bounds[i]) for i in entries),
        exit_m=tuple(float(bounds[i]) for i in exits),
        length_m=raw.length_m,
        xy_m=xy,
        yaw_rad=yaw,
        curvature_1pm=curvature,
        limit_mps=np.array([part.speed_mps for part in parts])[lane_of],
    )


def _smoothed(raw: Polyline, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return *count* points of *raw* with rounded corners, their headings and curvatures.

    Every corner is rounded over two metres each way, and further if it is too tight for a car. If that would cut
    the corner by more than _SWING_MIN_CUT_M, the line swings out before it, as drivers do.
    """
    s = SPACING_M * np.arange(-_EXTRA_POINTS, count + _EXTRA_POINTS, dtype=np.float64)
    xy = _convolved(raw.at(s, extrapolate=True)[0], _SMOOTHING, "valid")
    rounded = _rounded(xy)
    cut = rounded - xy
    max_cut_m = float(np.hypot(*cut.T).max())
    if max_cut_m > _SWING_MIN_CUT_M:
        margin = len(_SWING_KERNEL) // 2
        smooth = _convolved(np.pad(cut, ((margin, margin), (0, 0)), mode="edge"), _SWING_KERNEL, "valid")
        swing_m = min(_SWING_PER_CUT * max_cut_m, _MAX_SWING_M)
        shifted = np.concatenate((smooth[_SWING_LEAD:], np.zeros((_SWING_LEAD, 2))))
        rounded = _rounded(xy - swing_m / float(np.hypot(*smooth.T).max()) * shifted)
    trim = slice(_EXTRA_POINTS - len(_SMOOTHING) // 2, _EXTRA_POINTS - len(_SMOOTHING) // 2 + count)
    yaw, curvature = _bends(rounded)
    return rounded[trim], yaw[trim], curvature[trim]


def _rounded(xy_m: FloatArray) -> FloatArray:
    """Return points (P, 2), ``SPACING_M`` apart, smoothed where the curvature is too high for a car."""
    xy = xy_m
    for _ in range(_MAX_ROUNDINGS):
        too_tight = np.convolve(np.abs(_bends(xy)[1]) > _MAX_CURVATURE_1PM, np.ones(9), mode="same") > 0
        if not too_tight[2:-2].any():
            break
        too_tight[:2] = too_tight[-2:] = False
        xy = np.where(too_tight[:, None], _convolved(xy, _SMOOTHING, "same"), xy)
    return xy


def _convolved(xy_m: FloatArray, kernel: FloatArray, mode: Literal["same", "valid"]) -> FloatArray:
    """Return points (P, 2) convolved with *kernel*."""
    return np.stack([np.convolve(xy_m[:, axis], kernel, mode=mode) for axis in (0, 1)], axis=-1)


def _bends(xy_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return heading and curvature (P,) of points (P, 2), ``SPACING_M`` apart."""
    tangent = np.gradient(xy_m, axis=0)
    yaw = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    return yaw, np.gradient(yaw, SPACING_M)


def _link_lanes(lanes: Sequence[str], links: Sequence[Link]) -> tuple[list[int], list[int]]:
    """Return, for each link, the index of its first lane on the junction and of the lane beyond it."""
    entries, exits, beyond = [], [], 0
    for link in links:
        beyond = lanes.index(link.to_lane, beyond + (beyond > 0))
        inside = sum(lane in link.via for lane in lanes[max(0, beyond - len(link.via)) : beyond])
        entries.append(beyond - inside)
        exits.append(beyond)
    return entries, exits
