"""Find the edges at whose end a stop line or traffic light stops traffic.

The carriageway or the lanes that the map names decide. If it names none, geometry decides.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.netplan import EdgePlan, NetPlan

NEAR_M = 6.0  # a stop line or light at most this far beyond the end of a lane belongs to the lane
UPSTREAM_M = 30.0  # a stop line across a lane at most this far before its end belongs to the lane
BLOCK_SLACK_M = 2.0  # a lane that ends at most this far outside a carriageway counts as ending in it
BACK_M = 5.0  # a lane that ends in a carriageway must also lie in it this far before its end
ACROSS = 0.7  # cosine of the smallest angle between a stop line and a lane that it stops
LONG = 1.5  # a shape whose length is at least this multiple of its width has a direction


class Approaches:
    """Index of the last metres of a plan's edge lanes, to find which edges a light or stop line stops."""

    def __init__(self, plan: NetPlan) -> None:
        self._lines = [lane.shape_m for edge in plan.edges for lane in edge.lanes]
        self._widths_m = [lane.width_m for edge in plan.edges for lane in edge.lanes]
        self._owner = [edge.id for edge in plan.edges for _ in edge.lanes]
        self._last = [_with_extension(line) for line in self._lines]
        self._tree = shapely.STRtree(self._last)
        self._next: dict[str, set[str]] = defaultdict(set)
        for connection in plan.connections:
            self._next[connection.origin[0]].add(connection.target[0])
        self._of_lane = _last_edges(plan.edges)

    def stopped_by(
        self, at: BaseGeometry | None, block: Polygon | None = None, lanes: Iterable[int] = ()
    ) -> set[str]:
        """Return the edges that a light or stop line stops at their end.

        Args:
            at: line, area or position of the light or stop line; None if unknown.
            block: the carriageway at whose end it stands; None if the map names none.
            lanes: numbers of the source lanes that it stops.
        """
        edges = {self._of_lane[lane] for lane in lanes if lane in self._of_lane}
        if not edges and block is not None:
            edges = self._ending_in(block)
        if not edges and at is not None:
            edges = self._crossed_by(at)
        return edges

    def _ending_in(self, block: Polygon) -> set[str]:
        """Return the edges that end at the end of *block*, without those that lead to another edge ending in it."""
        area = block.buffer(BLOCK_SLACK_M)
        inside = {
            self._owner[number]
            for number in self._tree.query(area, predicate="intersects").tolist()
            if _ends_in(self._lines[number], area)
        }
        return {edge for edge in inside if not self._next[edge] & inside} or inside

    def _crossed_by(self, at: BaseGeometry) -> set[str]:
        """Return the edges whose last metres *at* crosses; if *at* has no direction, those that end near it."""
        axis = _axis(at)
        edges = set()
        for number in self._tree.query(at, predicate="dwithin", distance=NEAR_M).tolist():
            end = Point(self._lines[number][-1])
            reach = 0.5 * self._widths_m[number]
            is_near = (
                at.distance(self._last[number]) <= reach if axis is not None else at.distance(end) <= NEAR_M
            )
            if is_near and (axis is None or _is_across(axis, self._lines[number])):
                edges.add(self._owner[number])
        return edges


def _last_edges(edges: Iterable[EdgePlan]) -> dict[int, str]:
    """Return the last edge of each source lane."""
    last: dict[int, tuple[float, str]] = {}
    for edge in edges:
        for lane in edge.lanes:
            end_and_edge = (lane.piece.to_m, edge.id)
            last[lane.piece.lane] = max(end_and_edge, last.get(lane.piece.lane, end_and_edge))
    return {lane: edge for lane, (_, edge) in last.items()}


def _with_extension(line: FloatArray) -> LineString:
    """Return the last ``UPSTREAM_M`` of a lane (N, 2), extended straight ahead by ``NEAR_M``."""
    total = line_length_m(line)
    last = polyline.cut(line, max(0.0, total - UPSTREAM_M), total)
    beyond = line[-1] + NEAR_M * polyline.direction(line[-2], line[-1])
    return LineString(np.vstack((last, beyond)))


def _ends_in(line: FloatArray, area: BaseGeometry) -> bool:
    """Return whether the end of a lane (N, 2) and a point up to ``BACK_M`` before it lie in *area*."""
    total = line_length_m(line)
    points = polyline.at(line, np.array([total, max(total - BACK_M, 0.5 * total)]))
    return all(area.contains(Point(point)) for point in points)


def _axis(shape: BaseGeometry) -> FloatArray | None:
    """Return the unit vector (2,) along a line or a narrow area; None for a point or a compact area."""
    if shape.length == 0.0:
        return None
    box = shapely.minimum_rotated_rectangle(shape)
    corners = shapely.get_coordinates(box)
    if isinstance(box, LineString):
        return polyline.direction(corners[0], corners[-1])
    sides = np.diff(corners[:3], axis=0)
    lengths = np.hypot(*sides.T)
    if lengths.max() < LONG * lengths.min():
        return None
    return np.asarray(sides[lengths.argmax()] / lengths.max())


def _is_across(axis: FloatArray, line: FloatArray) -> bool:
    """Return whether a stop line with direction *axis* (2,) lies across the end of a lane (N, 2)."""
    along = line[-1] - line[-2]
    return bool(abs(float(axis @ along)) <= ACROSS * float(np.hypot(*along)))
