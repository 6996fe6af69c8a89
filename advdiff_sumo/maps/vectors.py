"""Vector crops of the map around a pose: pieces of centre lines and of the road's edge, resampled beforehand."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.spatial import cKDTree

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.polylines import Polyline, without_repeats
from advdiff_sumo.maps.lanes import Lane

PIECE_M = 20.0
"""Longest piece; longer lines are cut into equal parts."""
_SHORTEST_M = 0.05


class VectorKind(IntEnum):
    """What a polyline of a crop is."""

    LANE = 0
    INTERNAL_LANE = 1
    ROAD_EDGE = 2


@dataclass(frozen=True)
class MapVectors:
    """A crop in the frame of a pose (x forward, y left); P polylines of N points, nearest first.

    Rows beyond the polylines found are zero and masked out.

    Attributes:
        xy_m: (P, N, 2) points in driving direction; a road's edge has the road on its left.
        tangent: (P, N, 2) unit vectors along the line.
        mask: (P, N) whether the point is real.
        width_m: (P,) width of the lane, 0 for a road's edge.
        speed_mps: (P,) speed limit, 0 for a road's edge.
        kind: (P,) values of :class:`VectorKind`.
        distance_m: (P,) distance of the polyline from the pose.
    """

    xy_m: FloatArray
    tangent: FloatArray
    mask: BoolArray
    width_m: FloatArray
    speed_mps: FloatArray
    kind: IntArray
    distance_m: FloatArray


class VectorIndex:
    """All pieces of a map at one resolution, with a search tree over their midpoints.

    Args:
        lanes: lanes to show.
        rings: closed boundary rings (K, 2) of the drivable area, area on the left.
        points: N points of each piece.
        piece_m: longest piece.
    """

    def __init__(
        self, lanes: Iterable[Lane], rings: Iterable[FloatArray], points: int, piece_m: float = PIECE_M
    ) -> None:
        xy: list[FloatArray] = []
        rows: list[tuple[float, float, int]] = []
        for lane in lanes:
            kind = VectorKind.INTERNAL_LANE if lane.is_internal else VectorKind.LANE
            pieces = _pieces(lane.line, points, piece_m)
            xy += pieces
            rows += [(lane.width_m, lane.speed_mps, int(kind))] * len(pieces)
        for ring in rings:
            if len(without_repeats(ring)) > 2:
                pieces = _pieces(Polyline.of(ring), points, piece_m)
                xy += pieces
                rows += [(0.0, 0.0, int(VectorKind.ROAD_EDGE))] * len(pieces)
        self._xy = np.array(xy).reshape(-1, points, 2)
        table = np.array(rows, dtype=np.float64).reshape(-1, 3)
        self._width, self._speed = table[:, 0].copy(), table[:, 1].copy()
        self._kind = table[:, 2].astype(np.int64)
        self._tangent = _tangents(self._xy)
        self._steps = np.diff(self._xy, axis=1)
        self._steps_squared = np.maximum((self._steps**2).sum(-1), 1e-18)
        centre = 0.5 * (self._xy.min(axis=1) + self._xy.max(axis=1))
        reach = np.hypot(*np.moveaxis(self._xy - centre[:, None], -1, 0)).max(axis=1, initial=0.0)
        self._reach = float(reach.max(initial=0.0))
        self._tree = cKDTree(centre)

    def crop(self, xy_m: FloatArray, yaw_rad: float, radius_m: float, max_polylines: int) -> MapVectors:
        """Return the pieces that come within *radius_m* of the pose, at most *max_polylines*, nearest first."""
        near = np.array(self._tree.query_ball_point(xy_m, radius_m + self._reach), dtype=np.int64)
        distance = self._distance(near, xy_m)
        inside = distance <= radius_m
        near, distance = near[inside], distance[inside]
        order = np.lexsort((near, distance))[:max_polylines]
        return self._padded(near[order], distance[order], xy_m, yaw_rad, max_polylines)

    def _distance(self, rows: IntArray, xy_m: FloatArray) -> FloatArray:
        """Return the distance (K,) of the point to the pieces *rows* (K,)."""
        delta = xy_m - self._xy[rows, :-1]
        steps = self._steps[rows]
        share = np.clip(np.einsum("knc,knc->kn", delta, steps) / self._steps_squared[rows], 0.0, 1.0)
        delta -= share[..., None] * steps
        squared = np.einsum("knc,knc->kn", delta, delta)
        return np.asarray(np.sqrt(squared.min(axis=1, initial=np.inf)))

    def _padded(
        self, rows: IntArray, distance: FloatArray, xy_m: FloatArray, yaw_rad: float, size: int
    ) -> MapVectors:
        count, points = len(rows), self._xy.shape[1]
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        local_from_world = np.array([[cos, -sin], [sin, cos]])  # right-multiplied: v @ R = R⁻¹ v
        xy, tangent = np.zeros((2, size, points, 2))
        xy[:count] = (self._xy[rows] - xy_m) @ local_from_world
        tangent[:count] = self._tangent[rows] @ local_from_world
        mask = np.zeros((size, points), dtype=np.bool_)
        mask[:count] = True
        width, speed, away = np.zeros((3, size))
        width[:count], speed[:count], away[:count] = self._width[rows], self._speed[rows], distance
        kind = np.zeros(size, dtype=np.int64)
        kind[:count] = self._kind[rows]
        return MapVectors(xy, tangent, mask, width, speed, kind, away)


def _pieces(line: Polyline, points: int, piece_m: float) -> list[FloatArray]:
    """Return *line* cut into equal parts of at most *piece_m*, each as *points* evenly spaced points."""
    if line.length_m < _SHORTEST_M:
        return []
    parts = max(1, int(np.ceil(line.length_m / piece_m - 1e-9)))
    share = np.linspace(0.0, 1.0, points)
    starts = np.arange(parts)[:, None]
    return list(line.at((starts + share) * (line.length_m / parts))[0])


def _tangents(xy_m: FloatArray) -> FloatArray:
    """Return unit vectors (M, N, 2) along the points, by central differences, one-sided at the ends."""
    if len(xy_m) == 0:
        return xy_m.copy()
    delta = np.gradient(xy_m, axis=1)
    size = np.hypot(delta[..., :1], delta[..., 1:])
    return np.asarray(delta / np.maximum(size, 1e-12))
