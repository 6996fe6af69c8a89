"""Finds the lanes near given points or poses with a spatial index over all centre lines."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.maps.drivable import geometries
from advdiff_sumo.maps.lanes import Lane, LanePose

SIGMA_DISTANCE_M = 1.0
"""Standard deviation of the distance to the centre line of the correct lane, in the cost of a candidate."""
SIGMA_YAW_RAD = 0.5
"""Standard deviation of the heading error against the correct lane, in the cost of a candidate."""
OFF_ROUTE_COST = 9.0
"""Cost of a lane off the given route; equals that of a lateral offset of 3 m."""
_COST_ROUNDING = 1e-6
"""Margin in cost that exceeds the rounding of costs before they are compared."""


@dataclass(frozen=True)
class LaneCandidates:
    """C pairs of a point and a lane near it, sorted by point.

    Attributes:
        point: (C,) index of the point.
        lane: (C,) index of the lane in :attr:`LaneIndex.lane_ids`.
        s_m: (C,) arc length of the lane's position that is nearest to the point.
        d_m: (C,) signed distance from it, left positive; beyond an end of the lane, the distance to the end point.
        yaw_rad: (C,) heading of the lane at it.
    """

    point: IntArray
    lane: IntArray
    s_m: FloatArray
    d_m: FloatArray
    yaw_rad: FloatArray

    def rows(self, keep: BoolArray | IntArray) -> LaneCandidates:
        """Return the candidates that *keep* (indices or a mask) selects."""
        return LaneCandidates(
            self.point[keep], self.lane[keep], self.s_m[keep], self.d_m[keep], self.yaw_rad[keep]
        )


class LaneIndex:
    """Spatial index over the centre lines of L lanes (lane id → lane), by their segments."""

    def __init__(self, lanes: Mapping[str, Lane]) -> None:
        self.lane_ids: tuple[str, ...] = tuple(lanes)
        self._lanes = lanes
        lines = [lane.line for lane in lanes.values()]
        counts = np.array([len(line.s_m) - 1 for line in lines], dtype=np.int64)
        self._lane_of = np.repeat(np.arange(len(lines)), counts)
        self._start = np.concatenate([line.xy_m[:-1] for line in lines])
        self._end = np.concatenate([line.xy_m[1:] for line in lines])
        self._tangent = np.concatenate([line.tangents for line in lines])
        self._s0 = np.concatenate([line.s_m[:-1] for line in lines])
        self._step = np.concatenate([np.diff(line.s_m) for line in lines])
        self._yaw = np.concatenate([line.segment_yaw_rad for line in lines])

    @cached_property
    def _tree(self) -> shapely.STRtree:
        return shapely.STRtree(geometries(shapely.linestrings(np.stack((self._start, self._end), axis=1))))

    @cached_property
    def row(self) -> Mapping[str, int]:
        """Index of each lane id."""
        return {name: i for i, name in enumerate(self.lane_ids)}

    @cached_property
    def is_internal(self) -> BoolArray:
        """(L,) whether each lane lies on a junction."""
        return np.array([lane.is_internal for lane in self._lanes.values()])

    @cached_property
    def is_drivable(self) -> BoolArray:
        """(L,) whether each lane is open to some road motor vehicle."""
        return self.permits(None)

    @cached_property
    def width_m(self) -> FloatArray:
        """(L,) width of each lane."""
        return np.array([lane.width_m for lane in self._lanes.values()])

    def permits(self, vclass: str | None) -> BoolArray:
        """Return (L,) whether each lane is open to *vclass* (None: to any road motor vehicle)."""
        return np.array([lane.permits(vclass) for lane in self._lanes.values()])

    def candidates(self, xy_m: FloatArray, radius_m: float) -> LaneCandidates:
        """Return the nearest position on every lane within *radius_m* of each point *xy_m* (N, 2).

        Points with NaN have none. Candidates are sorted by point, then lane.
        """
        finite = np.flatnonzero(np.isfinite(xy_m).all(axis=1))
        points = shapely.points(xy_m[finite])
        point, segment = self._tree.query(points, predicate="dwithin", distance=radius_m)
        point = finite[point]
        delta = xy_m[point] - self._start[segment]
        tangent = self._tangent[segment]
        along = np.clip((delta * tangent).sum(-1), 0.0, self._step[segment])
        offset = delta - along[:, None] * tangent
        distance = np.hypot(offset[:, 0], offset[:, 1])
        lane = self._lane_of[segment]
        # at a corner two segments are equally near: take the later one, like Polyline.segment_at
        order = np.lexsort((-segment, np.round(distance, 9), lane, point))
        is_nearest = np.ones(len(order), dtype=np.bool_)
        is_nearest[1:] = (np.diff(point[order]) != 0) | (np.diff(lane[order]) != 0)
        row = order[is_nearest]
        cross = tangent[row, 0] * offset[row, 1] - tangent[row, 1] * offset[row, 0]
        return LaneCandidates(
            point=point[row],
            lane=lane[row],
            s_m=self._s0[segment[row]] + along[row],
            d_m=np.copysign(distance[row], cross),
            yaw_rad=self._yaw[segment[row]],
        )

    def best(
        self,
        xy_m: FloatArray,
        yaw_rad: FloatArray | None,
        radius_m: float,
        allowed: BoolArray,
        on_route: BoolArray | None = None,
    ) -> LaneCandidates:
        """Return for each point the candidate of least cost; none for a point without a permitted lane nearby.

        The cost is (distance / :data:`SIGMA_DISTANCE_M`)² + (heading error / :data:`SIGMA_YAW_RAD`)², plus
        :data:`OFF_ROUTE_COST` off the route. Of equal costs the lane listed first is taken.

        Args:
            xy_m: (N, 2) points.
            yaw_rad: (N,) headings; None: only the distance counts.
            radius_m: largest distance of a lane.
            allowed: (L,) mask of the lanes that may be chosen.
            on_route: (L,) mask of the lanes of the vehicle's route; None: without a route.
        """
        candidates = self.candidates(xy_m, radius_m)
        candidates = candidates.rows(allowed[candidates.lane])
        cost = candidate_cost(candidates, yaw_rad)
        if on_route is not None:
            cost = cost + np.where(on_route[candidates.lane], 0.0, OFF_ROUTE_COST)
        order = np.lexsort((candidates.lane, np.round(cost, 9), candidates.point))
        is_cheapest = np.ones(len(order), dtype=np.bool_)
        is_cheapest[1:] = np.diff(candidates.point[order]) != 0
        return candidates.rows(order[is_cheapest])

    def on_lane(
        self, xy_m: FloatArray, yaw_rad: FloatArray, radius_m: float, allowed: BoolArray
    ) -> BoolArray:
        """Return (N,) whether each point is within the width of the lane that :meth:`best` returns for it.

        Most points need a search only within half the narrowest lane's width. A candidate there that costs less than
        that distance alone is the best of all lanes, as any cheaper lane would have to be within it too.
        Arguments as in :meth:`best`.
        """
        half_width_m = 0.5 * self.width_m
        narrowest_m = float(half_width_m[allowed].min(initial=radius_m))
        near = self.best(xy_m, yaw_rad, narrowest_m, allowed)
        is_on_lane = np.zeros(len(xy_m), dtype=np.bool_)
        certain_cost = (narrowest_m / SIGMA_DISTANCE_M) ** 2 - _COST_ROUNDING
        is_on_lane[near.point] = candidate_cost(near, yaw_rad) < certain_cost
        off_lane = np.flatnonzero(~is_on_lane)
        if len(off_lane):
            best = self.best(xy_m[off_lane], yaw_rad[off_lane], radius_m, allowed)
            is_on_lane[off_lane[best.point]] = np.abs(best.d_m) <= half_width_m[best.lane]
        return is_on_lane

    @cached_property
    def _lanes_of_edge(self) -> Mapping[str, list[Lane]]:
        lanes = defaultdict[str, list[Lane]](list)
        for lane in self._lanes.values():
            if not lane.is_internal:
                lanes[lane.edge_id].append(lane)
        return dict(lanes)

    def route_mask(self, route: Sequence[str]) -> BoolArray:
        """Return (L,) whether each lane belongs to the edges of *route* or to the internal lanes between them."""
        mask = np.zeros(len(self.lane_ids), dtype=np.bool_)
        edge_pairs = set(pairwise(route))
        for lane in (lane for edge in set(route) for lane in self._lanes_of_edge.get(edge, ())):
            mask[self.row[lane.id]] = True
            for link in lane.successors:
                if (lane.edge_id, self._lanes[link.to_lane].edge_id) in edge_pairs:
                    mask[[self.row[x] for x in link.via if x in self.row]] = True
        return mask


def candidate_cost(candidates: LaneCandidates, yaw_rad: FloatArray | None) -> FloatArray:
    """Return the cost (C,) of each candidate, without that of the route.

    Args:
        candidates: C pairs of points and lanes.
        yaw_rad: (N,) headings of the points; None: only the distance counts.
    """
    cost = (candidates.d_m / SIGMA_DISTANCE_M) ** 2
    if yaw_rad is None:
        return cost
    error = np.nan_to_num(wrap_angle(yaw_rad[candidates.point] - candidates.yaw_rad))
    return cost + (error / SIGMA_YAW_RAD) ** 2


def poses_of(index: LaneIndex, candidates: LaneCandidates, yaw_rad: FloatArray | None) -> list[LanePose]:
    """Return *candidates* as lane poses; the heading errors are 0 if no headings (N,) were given."""
    error = (
        np.zeros(len(candidates.lane))
        if yaw_rad is None
        else wrap_angle(yaw_rad[candidates.point] - candidates.yaw_rad)
    )
    return [
        LanePose(index.lane_ids[lane], float(s), float(d), float(e))
        for lane, s, d, e in zip(candidates.lane, candidates.s_m, candidates.d_m, error, strict=True)
    ]
