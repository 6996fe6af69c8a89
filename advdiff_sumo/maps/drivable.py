"""Builds the drivable area, outside of which a vehicle has left the road, and answers queries about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.maps.lanes import Junction, Lane, edge_of_lane

_SEAM_M = 0.05
"""Half the width of the gaps between lanes that are closed."""
_GRID_M = 1e-6
"""Corners are rounded to this; without it, GEOS loses whole lanes if corners differ in the last bits only."""
_TILE_POINTS = 48
"""Tiles with at most this many points are not split further."""
_TILE_M = 5.0
"""Tiles of at most this extent are not split further."""


def area_of_lanes(lanes: Iterable[Lane], junctions: Mapping[str, Junction]) -> BaseGeometry:
    """Return the union of the carriageway lanes (centre lines widened, with flat ends) and the junction outlines.

    A lane for bicycles only belongs to it if its edge has a lane for motor vehicles. Sidewalks and rails do not.
    Gaps of a few centimetres are closed.
    """
    lanes = list(lanes)
    road_edges = {lane.edge_id for lane in lanes if lane.is_drivable}
    parts: list[BaseGeometry] = [
        shapely.LineString(lane.centre_xy_m).buffer(0.5 * lane.width_m, cap_style="flat", join_style="round")
        for lane in lanes
        if lane.is_drivable or (lane.edge_id in road_edges and "bicycle" in lane.allows)
    ]
    parts += [
        shapely.make_valid(Polygon(junction.shape_xy_m))
        for junction in junctions.values()
        if len(junction.shape_xy_m) >= 3
        and any(edge_of_lane(lane) in road_edges for lane in junction.incoming_lanes)
    ]
    union = shapely.union_all(parts, grid_size=_GRID_M)
    area = union.buffer(_SEAM_M, join_style="mitre").buffer(-_SEAM_M, join_style="mitre")
    if shapely.is_valid(area):
        return area
    # a junction without extent is a line; buffering it may leave a ring that crosses itself
    return shapely.make_valid(area, method="structure", keep_collapsed=False)


class DrivableArea:
    """A drivable area with spatial indices for fast queries.

    Attributes:
        geometry: the area, as a prepared (multi)polygon.
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
        """Return the boundary rings, simplified with a tolerance of 5 cm."""
        parts = shapely.get_parts(shapely.simplify(self.geometry, 0.05))
        return tuple(
            shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.orient_polygons(parts))
        )

    @cached_property
    def _edges(self) -> shapely.STRtree:
        segments = [np.stack((ring[:-1], ring[1:]), axis=1) for ring in self.rings]
        return shapely.STRtree(geometries(shapely.linestrings(np.concatenate(segments))))

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
        is_partly_off = ~shapely.covers(self.geometry, boxes)
        rows, boxes = rows[is_partly_off], boxes[is_partly_off]
        if len(rows):
            tree, tiles = self._tiles
            box, tile = tree.query(boxes, predicate="intersects")
            shared_m2 = shapely.area(shapely.intersection(boxes[box], tiles[tile]))
            covered_m2 = np.bincount(box, weights=shared_m2, minlength=len(rows))
            area_m2 = np.maximum(shapely.area(boxes), 1e-12)
            share[rows] = np.clip(1.0 - covered_m2 / area_m2, 0.0, 1.0)
        return share

    def edge_distance_m(self, xy_m: FloatArray) -> FloatArray:
        """Return the distance (N,) of points (N, 2) to the boundary, positive inside; NaN for NaN."""
        signed_m = np.full(len(xy_m), np.nan)
        finite = np.isfinite(xy_m).all(axis=1)
        points = geometries(shapely.points(xy_m[finite]))
        (row, _), found_m = self._edges.query_nearest(points, return_distance=True, all_matches=False)
        distance_m = np.full(len(points), np.nan)
        distance_m[row] = found_m
        signed_m[finite] = np.where(self.covers(xy_m[finite]), distance_m, -distance_m)
        return signed_m


def geometries(shapes: object) -> NDArray[np.object_]:
    """Return the result of a shapely constructor as an array (N,), also if it is a single geometry."""
    return np.atleast_1d(np.asarray(shapes, dtype=np.object_))


def _split(part: BaseGeometry, tiles: list[BaseGeometry]) -> None:
    """Halve *part* across its longer side until each piece is small or has few points; append the pieces to *tiles*."""
    pending = [part]
    while pending:
        piece = pending.pop()
        if piece.geom_type not in ("Polygon", "MultiPolygon"):
            pending += [g for g in shapely.get_parts(piece) if g.geom_type == "Polygon"]
            continue
        if piece.is_empty or piece.area <= 0.0:
            continue
        x0, y0, x1, y1 = piece.bounds
        is_small = max(x1 - x0, y1 - y0) <= _TILE_M
        if is_small or shapely.get_num_coordinates(piece) <= _TILE_POINTS:
            tiles.append(piece)
            continue
        if x1 - x0 >= y1 - y0:
            middle = 0.5 * (x0 + x1)
            halves = (shapely.box(x0, y0, middle, y1), shapely.box(middle, y0, x1, y1))
        else:
            middle = 0.5 * (y0 + y1)
            halves = (shapely.box(x0, y0, x1, middle), shapely.box(x0, middle, x1, y1))
        pending += [shapely.intersection(piece, half) for half in halves]
