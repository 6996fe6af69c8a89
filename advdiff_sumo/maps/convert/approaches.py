"""Which edges a stop line or traffic light stops: by the carriageway or lanes that it names, else by geometry."""

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

NEAR_M = 6.0  # a stop line or light within this beyond the end of a lane is that lane's
UPSTREAM_M = 30.0  # a stop line across a lane within this of its end is that lane's
BLOCK_SLACK_M = 2.0  # a lane that ends this near outside a carriageway still ends in it
BACK_M = 5.0  # the lane must lie in the carriageway so far before its end
ACROSS = 0.7  # cosine of the smallest angle between a stop line and the lanes that it stops
LONG = 1.5  # a shape so much longer than wide has a direction


class Approaches:
    """The ends of a plan's edge lanes, ready to be asked what stops them."""

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
            at: its line, area or place; None where unknown.
            block: the carriageway that it ends.
            lanes: numbers of the lanes that it stops.
        """
        edges = {self._of_lane[lane] for lane in lanes if lane in self._of_lane}
        if not edges and block is not None:
            edges = self._ending_in(block)
        if not edges and at is not None:
            edges = self._crossed_by(at)
        return edges

    def _ending_in(self, block: Polygon) -> set[str]:
        """Return the edges that leave *block* at their end, not those that lead on within it."""
        area = block.buffer(BLOCK_SLACK_M)
        inside = {
            self._owner[number]
            for number in self._tree.query(area, predicate="intersects").tolist()
            if _ends_in(self._lines[number], area)
        }
        return {edge for edge in inside if not self._next[edge] & inside} or inside

    def _crossed_by(self, at: BaseGeometry) -> set[str]:
        """Return the edges whose last metres *at* lies across, or that end within six metres of a point."""
        axis = _axis(at)
        edges = set()
        for number in self._tree.query(at, predicate="dwithin", distance=NEAR_M).tolist():
            end = Point(self._lines[number][-1])
            reach = 0.5 * self._widths_m[number]
            near = (
                at.distance(self._last[number]) <= reach if axis is not None else at.distance(end) <= NEAR_M
            )
            if near and (axis is None or _is_across(axis, self._lines[number])):
                edges.add(self._owner[number])
        return edges


def _last_edges(edges: Iterable[EdgePlan]) -> dict[int, str]:
    """Return the last edge of each source lane."""
    last: dict[int, tuple[float, str]] = {}
    for edge in edges:
        for lane in edge.lanes:
            place = (lane.piece.to_m, edge.id)
            last[lane.piece.lane] = max(place, last.get(lane.piece.lane, place))
    return {lane: edge for lane, (_, edge) in last.items()}


def _with_extension(line: FloatArray) -> LineString:
    """Return the last metres of a lane, prolonged straight on."""
    total = line_length_m(line)
    last = polyline.cut(line, max(0.0, total - UPSTREAM_M), total)
    along = (line[-1] - line[-2]) / np.hypot(*(line[-1] - line[-2]))
    return LineString(np.vstack((last, line[-1] + NEAR_M * along)))


def _ends_in(line: FloatArray, area: BaseGeometry) -> bool:
    total = line_length_m(line)
    places = polyline.at(line, np.array([total, max(total - BACK_M, 0.5 * total)]))
    return all(area.contains(Point(place)) for place in places)


def _axis(shape: BaseGeometry) -> FloatArray | None:
    """Return the direction (2,) of a line or of a narrow area, or None."""
    if shape.length == 0.0:
        return None
    box = shapely.minimum_rotated_rectangle(shape)
    corners = shapely.get_coordinates(box)
    if isinstance(box, LineString):
        side = corners[-1] - corners[0]
        return np.asarray(side / np.hypot(*side))
    sides = np.diff(corners[:3], axis=0)
    lengths = np.hypot(*sides.T)
    if lengths.max() < LONG * lengths.min():
        return None
    return np.asarray(sides[lengths.argmax()] / lengths.max())


def _is_across(axis: FloatArray, line: FloatArray) -> bool:
    along = line[-1] - line[-2]
    return bool(abs(float(axis @ along)) <= ACROSS * float(np.hypot(*along)))
