"""The drivable area: where a vehicle may be without having left the road."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.maps.lanes import Junction, Lane

_ROUND_M = 0.05
_TILE_POINTS = 48
_TILE_M = 5.0


def area_of_lanes(lanes: Iterable[Lane], junctions: Mapping[str, Junction]) -> BaseGeometry:
    """Return the union of carriageway lanes (centre lines widened, ends flat) and junction outlines.

    Lanes that only bicycles may use count where their edge has a lane for motor vehicles; sidewalks and rails
    do not. Seams narrower than a few centimetres are closed.
    """
    lanes = list(lanes)
    roads = {lane.edge_id for lane in lanes if lane.is_drivable}
    parts: list[BaseGeometry] = [
        shapely.LineString(lane.centre_xy_m).buffer(0.5 * lane.width_m, cap_style="flat", join_style="round")
        for lane in lanes
        if lane.is_drivable or (lane.edge_id in roads and "bicycle" in lane.allows)
    ]
    reached = {lane.edge_id: None for lane in lanes if lane.is_drivable}
    parts += [
        shapely.make_valid(Polygon(junction.shape_xy_m))
        for junction in junctions.values()
        if len(junction.shape_xy_m) >= 3
        and any(lane.rsplit("_", 1)[0] in reached for lane in junction.incoming_lanes)
    ]
    area = shapely.union_all(parts).buffer(_ROUND_M, join_style="mitre").buffer(-_ROUND_M, join_style="mitre")
    if shapely.is_valid(area):
        return area
    # the end of a road whose junction has no extent: a line, of which the buffers leave a ring that crosses itself
    return shapely.make_valid(area, method="structure", keep_collapsed=False)


class DrivableArea:
    """Fast questions about one (multi)polygon.

    Attributes:
        geometry: the area, prepared.
    """

    def __init__(self, geometry: BaseGeometry) -> None:
        polygons = [g for g in shapely.get_parts(geometry) if g.geom_type == "Polygon" and g.area > 0.0]
        self.geometry: BaseGeometry = shapely.orient_polygons(shapely.multipolygons(polygons))
        if len(polygons) == 1:
            self.geometry = shapely.get_geometry(self.geometry, 0)
        shapely.prepare(self.geometry)

    @cached_property
    def rings(self) -> tuple[FloatArray, ...]:
        """Boundary rings (K, 2), closed, with the area on their left."""
        parts = shapely.get_parts(self.geometry)
        return tuple(shapely.get_coordinates(ring) for ring in shapely.get_rings(parts))

    def smooth_rings(self) -> tuple[FloatArray, ...]:
        """Return the rings with points that lie within 5 cm of a simpler outline left out."""
        parts = shapely.get_parts(shapely.simplify(self.geometry, 0.05))
        return tuple(
            shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.orient_polygons(parts))
        )

    @cached_property
    def _edges(self) -> shapely.STRtree:
        pairs = [np.stack((ring[:-1], ring[1:]), axis=1) for ring in self.rings]
        return shapely.STRtree(geometries(shapely.linestrings(np.concatenate(pairs))))

    @cached_property
    def _tiles(self) -> tuple[shapely.STRtree, NDArray[np.object_]]:
        tiles: list[BaseGeometry] = []
        for part in shapely.get_parts(self.geometry):
            _split(part, tiles)
        array = np.array(tiles, dtype=object)
        return shapely.STRtree(array), array

    def covers(self, xy_m: FloatArray) -> BoolArray:
        """Return whether the points (…, 2) lie in the area or on its boundary; NaN does not."""
        return np.asarray(shapely.intersects_xy(self.geometry, xy_m[..., 0], xy_m[..., 1]))

    def off_road_share(self, corners_m: FloatArray) -> FloatArray:
        """Return the share (N,) of each box (N, 4, 2) that lies outside the area, in [0, 1]; NaN for NaN."""
        share = np.zeros(len(corners_m))
        finite = np.isfinite(corners_m).all(axis=(1, 2))
        share[~finite] = np.nan
        boxes = geometries(shapely.polygons(corners_m[finite]))
        rows = np.flatnonzero(finite)
        partly = ~shapely.covers(self.geometry, boxes)
        rows, boxes = rows[partly], boxes[partly]
        if len(rows):
            tree, tiles = self._tiles
            box, tile = tree.query(boxes, predicate="intersects")
            inside = shapely.area(shapely.intersection(boxes[box], tiles[tile]))
            covered = np.bincount(box, weights=inside, minlength=len(rows))
            area = np.maximum(shapely.area(boxes), 1e-12)
            share[rows] = np.clip(1.0 - covered / area, 0.0, 1.0)
        return share

    def edge_distance_m(self, xy_m: FloatArray) -> FloatArray:
        """Return the distance (N,) of points (N, 2) to the boundary, positive inside; NaN for NaN."""
        distance = np.full(len(xy_m), np.nan)
        finite = np.isfinite(xy_m).all(axis=1)
        points = geometries(shapely.points(xy_m[finite]))
        (row, _), away = self._edges.query_nearest(points, return_distance=True, all_matches=False)
        distance_m = np.full(len(points), np.nan)
        distance_m[row] = away
        distance[finite] = np.where(self.covers(xy_m[finite]), distance_m, -distance_m)
        return distance


def geometries(shapes: object) -> NDArray[np.object_]:
    """Return what a shapely constructor made as an array (N,), for one geometry too."""
    return np.atleast_1d(np.asarray(shapes, dtype=np.object_))


def _split(part: BaseGeometry, tiles: list[BaseGeometry]) -> None:
    """Append *part* to *tiles*, halved across its longer side until each piece has few corners."""
    pending = [part]
    while pending:
        piece = pending.pop()
        if piece.geom_type not in ("Polygon", "MultiPolygon"):
            pending += [g for g in shapely.get_parts(piece) if g.geom_type == "Polygon"]
            continue
        if piece.is_empty or piece.area <= 0.0:
            continue
        x0, y0, x1, y1 = piece.bounds
        small = max(x1 - x0, y1 - y0) <= _TILE_M
        if small or shapely.get_num_coordinates(piece) <= _TILE_POINTS:
            tiles.append(piece)
            continue
        if x1 - x0 >= y1 - y0:
            middle = 0.5 * (x0 + x1)
            halves = (shapely.box(x0, y0, middle, y1), shapely.box(middle, y0, x1, y1))
        else:
            middle = 0.5 * (y0 + y1)
            halves = (shapely.box(x0, y0, x1, middle), shapely.box(x0, middle, x1, y1))
        pending += [shapely.intersection(piece, half) for half in halves]
