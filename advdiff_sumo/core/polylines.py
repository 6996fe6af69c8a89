"""Polylines with arc length: projection, interpolation, cutting, joining and shifting, for arrays.

Frenet coordinates: ``s`` is the distance along the line in metres, ``d`` the signed distance to its left.

Special inputs: a line needs two distinct finite points (ValueError otherwise); repeated points are dropped. Queries
outside [0, length] are clamped to the ends unless ``extrapolate`` is set. NaN queries give NaN. Empty query arrays give
empty arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray, read_only
from advdiff_sumo.core.frames import wrap_angle

SAME_POINT_M = 1e-9
"""Consecutive points nearer than this are one point."""

#: Greatest shift of a mitred corner, as a multiple of the line's shift.
_MITRE_LIMIT = 2.0


@dataclass(frozen=True, eq=False)
class Polyline:
    """A line through P distinct points; build it with :meth:`of`. Its arrays are read-only.

    Attributes:
        xy_m: (P, 2) points, P ≥ 2.
        s_m: (P,) arc length at each point, from 0, strictly increasing.
    """

    xy_m: FloatArray
    s_m: FloatArray

    def __post_init__(self) -> None:
        read_only(self.xy_m)
        read_only(self.s_m)

    @staticmethod
    def of(xy_m: FloatArray) -> Polyline:
        """Return the line through *xy_m* (N, 2), repeated points dropped.

        Raises:
            ValueError: for another shape, NaN or infinity, or fewer than two distinct points.
        """
        points = np.asarray(xy_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"a polyline needs points of shape (N, 2), not {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError("a polyline needs finite points")
        points = without_repeats(points)
        if len(points) < 2:
            raise ValueError("a polyline needs two distinct points")
        delta = points[1:] - points[:-1]
        lengths = np.hypot(delta[:, 0], delta[:, 1])
        return Polyline(points, np.concatenate(([0.0], np.cumsum(lengths))))

    @property
    def length_m(self) -> float:
        """Length of the line."""
        return float(self.s_m[-1])

    @cached_property
    def tangents(self) -> FloatArray:
        """(P − 1, 2) unit vectors along the segments."""
        delta = self.xy_m[1:] - self.xy_m[:-1]
        return read_only(np.asarray(delta / np.hypot(delta[:, :1], delta[:, 1:])))

    @cached_property
    def segment_yaw_rad(self) -> FloatArray:
        """(P − 1,) headings of the segments."""
        return read_only(np.arctan2(self.tangents[:, 1], self.tangents[:, 0]))

    @cached_property
    def curvature_1pm(self) -> FloatArray:
        """(P,) curvature at the points, left positive: turn divided by mean segment length; 0 at the ends."""
        turn = wrap_angle(np.diff(self.segment_yaw_rad))
        lengths = np.diff(self.s_m)
        return read_only(np.concatenate(([0.0], 2.0 * turn / (lengths[:-1] + lengths[1:]), [0.0])))

    def segment_at(self, s_m: FloatArray | float) -> IntArray:
        """Return the index (…,) of the segment at *s_m*; at a point, the segment that begins there."""
        index = np.searchsorted(self.s_m, np.asarray(s_m, dtype=np.float64), side="right") - 1
        return np.asarray(np.clip(index, 0, len(self.s_m) - 2), dtype=np.int64)

    def at(
        self, s_m: FloatArray | float, d_m: FloatArray | float = 0.0, *, extrapolate: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return points (…, 2) and headings (…,) at *s_m*, *d_m* to the left.

        Args:
            s_m: (…,) arc lengths, clamped to the line unless *extrapolate*.
            d_m: (…,) offsets to the left.
            extrapolate: whether the end segments are extended beyond the ends.
        """
        s, d = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(d_m, dtype=np.float64))
        if not extrapolate:
            s = np.clip(s, 0.0, self.length_m)
        segment = self.segment_at(s)
        tangent = self.tangents[segment]
        normal = np.stack((-tangent[..., 1], tangent[..., 0]), axis=-1)
        along = (s - self.s_m[segment])[..., None]
        xy = self.xy_m[segment] + along * tangent + d[..., None] * normal
        return xy, np.where(np.isnan(s), np.nan, self.segment_yaw_rad[segment])

    def project(self, xy_m: FloatArray, *, extrapolate: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return arc lengths (…,) and signed distances (…,), left positive, of points *xy_m* (…, 2).

        Beyond an end, ``s`` is clamped and ``|d|`` is the distance to the end point; with *extrapolate* the
        end segments are infinite instead. At a bend, all points of the outer wedge project to the corner.
        """
        points = np.asarray(xy_m, dtype=np.float64)
        delta = points[..., None, :] - self.xy_m[:-1]  # (…, P-1, 2)
        lengths = np.diff(self.s_m)
        along = delta[..., 0] * self.tangents[:, 0] + delta[..., 1] * self.tangents[:, 1]
        low, high = np.zeros_like(lengths), lengths.copy()
        if extrapolate:
            low[0], high[-1] = -np.inf, np.inf
        along = np.clip(along, low, high)
        offsets = delta - along[..., None] * self.tangents  # (…, P-1, 2) from each segment's nearest point
        squared = offsets[..., 0] ** 2 + offsets[..., 1] ** 2
        nearest = np.argmin(squared, axis=-1)[..., None]  # NaN rows give 0 here and NaN below
        tangent = self.tangents[nearest[..., 0]]
        offset = np.take_along_axis(offsets, nearest[..., None], axis=-2)[..., 0, :]
        cross = tangent[..., 0] * offset[..., 1] - tangent[..., 1] * offset[..., 0]
        s = self.s_m[nearest[..., 0]] + np.take_along_axis(along, nearest, axis=-1)[..., 0]
        return s, np.copysign(np.hypot(offset[..., 0], offset[..., 1]), cross)

    def resample(self, *, spacing_m: float | None = None, count: int | None = None) -> Polyline:
        """Return the line through evenly spaced points of this one, both ends included.

        Give exactly one of the arguments.

        Args:
            spacing_m: the largest spacing; the actual one divides the length evenly.
            count: the number of points, at least 2.
        """
        if (spacing_m is None) == (count is None):
            raise ValueError("give spacing_m or count, one of the two")
        if spacing_m is not None:
            if not spacing_m > 0.0:
                raise ValueError(f"spacing_m must be positive, not {spacing_m}")
            count = int(np.ceil(self.length_m / spacing_m - 1e-9)) + 1
        if count is None or count < 2:
            count = 2 if spacing_m is not None else count
        if count is None or count < 2:
            raise ValueError(f"count must be at least 2, not {count}")
        return Polyline.of(self.at(np.linspace(0.0, self.length_m, count))[0])

    def slice(self, start_m: float, stop_m: float) -> Polyline:
        """Return the part from *start_m* to *stop_m*, both clamped to the line.

        Raises:
            ValueError: if no length remains.
        """
        start, stop = (float(np.clip(s, 0.0, self.length_m)) for s in (start_m, stop_m))
        if not stop - start > SAME_POINT_M:
            raise ValueError(f"nothing of the line lies between {start_m} m and {stop_m} m")
        ends = self.at(np.array([start, stop]))[0]
        inside = self.xy_m[(self.s_m > start) & (self.s_m < stop)]
        return Polyline.of(np.vstack((ends[:1], inside, ends[1:])))

    def offset(self, d_m: float) -> Polyline:
        """Return the line shifted *d_m* to the left; corners are mitred and shift by at most twice as much.

        Where the line bends more tightly than *d_m*, the shifted line folds; use shapely for areas.
        """
        normals = np.stack((-self.tangents[:, 1], self.tangents[:, 0]), axis=-1)
        before, after = np.vstack((normals[:1], normals)), np.vstack((normals, normals[-1:]))
        cos = np.einsum("ij,ij->i", before, after)[:, None]
        mitre = (before + after) / np.maximum(1.0 + cos, 1e-6)
        size = np.hypot(mitre[:, :1], mitre[:, 1:])
        return Polyline.of(self.xy_m + d_m * mitre * np.minimum(1.0, _MITRE_LIMIT / np.maximum(size, 1e-9)))


def concatenate(lines: Sequence[Polyline]) -> Polyline:
    """Return *lines* joined end to start; a gap becomes a straight segment. ValueError if *lines* is empty."""
    if not lines:
        raise ValueError("no polylines to join")
    return Polyline.of(np.vstack([line.xy_m for line in lines]))


def stations_m(xy_m: FloatArray) -> FloatArray:
    """Return the arc length (N,) at each of the points (N, 2), from 0."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(xy_m, axis=0).T))))


def line_length_m(xy_m: FloatArray) -> float:
    """Return the length of the line through points (N, 2)."""
    return float(np.hypot(*np.diff(xy_m, axis=0).T).sum())


def distances_m(xy_m: FloatArray, other_xy_m: FloatArray) -> FloatArray:
    """Return the distances (P, Q) of the points (P, 2) from the points (Q, 2)."""
    return np.asarray(np.hypot(*(xy_m[:, None] - other_xy_m[None]).transpose(2, 0, 1)))


def without_repeats(xy_m: FloatArray) -> FloatArray:
    """Return the points (N, 2) without those that repeat the previous one."""
    return xy_m[kept_points(xy_m)]


def kept_points(xy_m: FloatArray) -> BoolArray:
    """Return (N,) which points to keep so that none repeats the previous one that is kept."""
    keep = np.ones(len(xy_m), dtype=np.bool_)
    delta = xy_m[1:] - xy_m[:-1]
    while (repeats := np.hypot(delta[:, 0], delta[:, 1]) <= SAME_POINT_M).any():
        keep[np.flatnonzero(keep)[1:][repeats]] = False
        delta = np.diff(xy_m[keep], axis=0)
    return keep
