"""Provides the streets of a picture: drivable area and markings, clipped to a view."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps import Lane, RoadMap


@dataclass(frozen=True)
class NetWindow:
    """A rectangle of the net, in its metres.

    Attributes:
        x0_m: west.
        y0_m: south.
        x1_m: east.
        y1_m: north.
    """

    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float

    @staticmethod
    def around(
        xy_m: FloatArray,
        margin_m: float,
        least_width_m: float,
        aspect: float = 1.5,
        most_width_m: float = np.inf,
    ) -> NetWindow:
        """Return the view of all finite points (N, 2), enlarged to *aspect* (width / height).

        It is at most *most_width_m* wide; then it is centred on the middle of the points' extent.
        """
        points = xy_m[np.isfinite(xy_m).all(axis=1)]
        points = points if len(points) else np.zeros((1, 2))
        low, high = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
        width = max(high[0] - low[0], aspect * (high[1] - low[1]), least_width_m)
        half_size = 0.5 * min(width, most_width_m) * np.array([1.0, 1.0 / aspect])
        (x0, y0), (x1, y1) = 0.5 * (low + high) - half_size, 0.5 * (low + high) + half_size
        return NetWindow(float(x0), float(y0), float(x1), float(y1))

    @property
    def width_m(self) -> float:
        """Extent to the east."""
        return self.x1_m - self.x0_m

    @property
    def height_m(self) -> float:
        """Extent to the north."""
        return self.y1_m - self.y0_m

    @property
    def rectangle(self) -> tuple[float, float, float, float]:
        """West, south, east, north."""
        return self.x0_m, self.y0_m, self.x1_m, self.y1_m


@dataclass(frozen=True)
class VisibleStreets:
    """The parts of a net in a view.

    Attributes:
        areas: closed rings (K, 2) of the drivable area, holes among them (even-odd rule).
        solid: lines (K, 2) between directions of travel.
        dashed: lines (K, 2) between lanes of one direction.
    """

    areas: tuple[FloatArray, ...] = ()
    solid: tuple[FloatArray, ...] = ()
    dashed: tuple[FloatArray, ...] = ()


class MapLayer:
    """The drawable parts of one net with a spatial index; made once per report."""

    def __init__(self, road: RoadMap) -> None:
        self.road = road
        lanes = [lane for lane in road.lanes.values() if lane.is_drivable and not lane.is_internal]
        solid, dashed = _markings(lanes, road.lefthand)
        self._lines = np.array([*solid, *dashed], dtype=object)
        self._is_solid = np.arange(len(self._lines)) < len(solid)
        self._tree = shapely.STRtree(self._lines)

    @property
    def view(self) -> NetWindow:
        """The whole net."""
        x0, y0, x1, y1 = self.road.bounds
        corner = np.array([[x0, y0], [x1, y1]])
        return NetWindow.around(
            corner, 0.02 * max(x1 - x0, y1 - y0), 1.0, max(x1 - x0, 1.0) / max(y1 - y0, 1.0)
        )

    def streets(self, view: NetWindow, tolerance_m: float = 0.1, markings: bool = True) -> VisibleStreets:
        """Return the streets in *view*, with outlines simplified to within *tolerance_m*."""
        # an intersection, as the faster clip_by_rect fills holes
        area = shapely.simplify(self.road.drivable & shapely.box(*view.rectangle), tolerance_m)
        rings = shapely.get_rings(_polygons(area))
        areas = tuple(shapely.get_coordinates(ring) for ring in rings)
        if not markings or not len(self._lines):
            return VisibleStreets(areas)
        line_indices = np.sort(self._tree.query(shapely.box(*view.rectangle)))
        clipped = [
            shapely.simplify(shapely.clip_by_rect(self._lines[i], *view.rectangle), 0.03)
            for i in line_indices
        ]
        solid = [line for i, line in zip(line_indices, clipped, strict=True) if self._is_solid[i]]
        dashed = [line for i, line in zip(line_indices, clipped, strict=True) if not self._is_solid[i]]
        return VisibleStreets(areas, _coordinates(solid), _coordinates(dashed))


def _markings(lanes: Iterable[Lane], lefthand: bool) -> tuple[list[BaseGeometry], list[BaseGeometry]]:
    """Return the lines on the inner side of *lanes*: solid for the innermost lane of an edge, else dashed."""
    solid: list[BaseGeometry] = []
    dashed: list[BaseGeometry] = []
    for lane in lanes:
        inner = lane.right_id if lefthand else lane.left_id
        offset = (-0.5 if lefthand else 0.5) * lane.width_m
        line = shapely.LineString(lane.centre_xy_m).offset_curve(offset)
        if not line.is_empty:
            (solid if inner is None else dashed).append(line)
    return solid, dashed


def _polygons(area: BaseGeometry) -> list[BaseGeometry]:
    """Return the polygons of *area*, also those in nested collections."""
    if area.geom_type == "Polygon":
        return [] if area.is_empty else [area]
    if not hasattr(area, "geoms"):
        return []
    return [polygon for part in shapely.get_parts(area) for polygon in _polygons(part)]


def _coordinates(lines: Iterable[BaseGeometry]) -> tuple[FloatArray, ...]:
    parts = (part for line in lines for part in shapely.get_parts(line))
    return tuple(shapely.get_coordinates(part) for part in parts if part.geom_type == "LineString")
