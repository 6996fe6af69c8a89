"""nuPlan maps (Caesar et al. 2021, arXiv:2106.11810): ``map.gpkg``, a GeoPackage (OGC 12-128r19) of one city.

Shapes are in degrees; places are in the projected system that the layer ``meta`` names, in m.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import shapely
from pyproj.exceptions import CRSError
from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.bounded_lanes import as_multi
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.map_files import MAX_FILE_BYTES
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap, StatedSizes

REMEDY = "give an unchanged map.gpkg of nuPlan"
NEEDED = ("meta", "baseline_paths", "lanes_polygons", "lane_connectors")
ENVELOPE_BYTES = (0, 32, 48, 48, 64)  # by the header's envelope code
Row = dict[str, Any]


def nuplan_map(path: Path) -> SourceMap:
    """Return the map in the GeoPackage *path*.

    Baseline paths are the centre lines; a lane connector joins its exit lane to its entry lane.

    Raises:
        MapError: no such GeoPackage, a layer is missing, or no lane is usable.
    """
    tables = _Tables(path)
    faults = MapFaults(path)
    lanes = [*_lanes(tables, faults), *_connectors(tables, faults)]
    if not lanes:
        raise MapError(path, "holds no lane with a baseline path", REMEDY)
    known = {lane.token for lane in lanes}
    links = list(_links(tables))
    given = [f"lane_{row['lane_fid']}" for row in tables.rows["lanes_polygons"]]
    given += [f"connector_{row['fid']}" for row in tables.rows["lane_connectors"]]
    return SourceMap(
        path=path,
        location=path.parent.parent.name or path.stem,
        lanes=tuple(lanes),
        links=tuple(link for link in links if set(link) <= known),
        drivable=tables.areas("generic_drivable_areas"),
        intersections=tuple(tables.areas("intersections").geoms),
        crossings=tuple(tables.areas("crosswalks").geoms),
        walkways=tuple(tables.areas("walkways").geoms),
        carparks=tuple(tables.areas("carpark_areas").geoms),
        stated=StatedSizes(len(given), len(links)),
        left_out=tuple(token for token in given if token not in known),
        notes=faults.notes,
        warnings=faults.sentences(),
    )


class _Tables:
    """The layers of a file; shapes are projected."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            size = path.stat().st_size
        except OSError as error:
            raise MapError(path, f"cannot be read ({error.strerror})", REMEDY) from None
        if size > MAX_FILE_BYTES:
            raise MapError(path, f"{size / 1e6:.0f} MB is more than any map has", REMEDY)
        try:
            with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as base:
                names = [row[0] for row in base.execute("SELECT name FROM sqlite_master WHERE type='table'")]
                self.rows = {
                    name: _rows(base, name) for name in names if not name.startswith(("gpkg_", "rtree_"))
                }
        except sqlite3.Error as error:
            raise MapError(path, f"is no GeoPackage ({error})", REMEDY) from None
        missing = next((name for name in NEEDED if name not in self.rows), None)
        if missing is not None:
            raise MapError(path, f"layer '{missing}' is missing", REMEDY)
        self._project = self._projection()

    def _projection(self) -> pyproj.Transformer:
        names = [row.get("value") for row in self.rows["meta"] if row.get("key") == "projectedCoordSystem"]
        try:
            return pyproj.Transformer.from_crs("EPSG:4326", str(names[0]), always_xy=True)
        except (IndexError, CRSError):
            problem = "layer 'meta' names no usable projectedCoordSystem"
            raise MapError(self.path, problem, REMEDY) from None

    def shape(self, row: Row) -> BaseGeometry | None:
        """Return the shape of a record in m, or None where it is unusable."""
        value = row.get("geom", row.get("geometry"))
        try:
            shape = shapely.from_wkb(_wkb(value))
        except (shapely.errors.ShapelyError, ValueError, TypeError, struct.error, IndexError):
            return None
        if shape.is_empty:
            return None
        moved = shapely.transform(shapely.force_2d(shape), self._to_metres)
        return moved if np.isfinite(shapely.get_coordinates(moved)).all() else None

    def _to_metres(self, degrees: Any) -> Any:
        return np.stack(self._project.transform(degrees[:, 0], degrees[:, 1]), axis=-1)

    def areas(self, layer: str) -> MultiPolygon:
        """Return the areas of *layer*; a layer that is absent has none."""
        shapes = [shape for row in self.rows.get(layer, []) if (shape := self.shape(row)) is not None]
        whole = [part for shape in shapes for part in as_multi(shapely.make_valid(shape)).geoms]
        return (
            MultiPolygon(whole) if layer != "generic_drivable_areas" else as_multi(shapely.union_all(whole))
        )


def _rows(base: sqlite3.Connection, name: str) -> list[Row]:
    cursor = base.execute(f'SELECT * FROM "{name}"')  # noqa: S608 - the name is one of the file's own tables
    columns = [column[0] for column in cursor.description]
    return [dict(zip(columns, row, strict=True)) for row in cursor]


def _wkb(value: Any) -> bytes:
    """Return the well-known binary in a GeoPackage's geometry, behind its header."""
    if not isinstance(value, bytes) or value[:2] != b"GP":
        raise ValueError("no geometry of a GeoPackage")
    return value[8 + ENVELOPE_BYTES[(value[3] >> 1) & 7] :]


def _lanes(tables: _Tables, faults: MapFaults) -> Iterable[SourceLane]:
    paths = {
        str(row["lane_fid"]): row for row in tables.rows["baseline_paths"] if row.get("lane_fid") is not None
    }
    for row in tables.rows["lanes_polygons"]:
        name = str(row.get("lane_fid"))
        lane = _lane(tables, f"lane_{name}", paths.get(name), row, tables.shape(row), faults)
        if lane is not None:
            yield lane


def _connectors(tables: _Tables, faults: MapFaults) -> Iterable[SourceLane]:
    key = "lane_connector_fid"
    paths = {str(row[key]): row for row in tables.rows["baseline_paths"] if row.get(key) is not None}
    polygons = {
        str(row.get(key)): row for row in tables.rows.get("gen_lane_connectors_scaled_width_polygons", [])
    }
    for row in tables.rows["lane_connectors"]:
        name = str(row.get("fid"))
        shape = tables.shape(polygons[name]) if name in polygons else None
        lane = _lane(tables, f"connector_{name}", paths.get(name), row, shape, faults)
        if lane is not None:
            yield lane


def _lane(
    tables: _Tables, token: str, path_row: Row | None, row: Row, shape: BaseGeometry | None, faults: MapFaults
) -> SourceLane | None:
    line = tables.shape(path_row) if path_row is not None else None
    if line is not None and line.geom_type == "MultiLineString":
        line = shapely.line_merge(line)
    centre = (
        drop_repeats(np.asarray(line.coords)[:, :2]) if isinstance(line, LineString) else np.empty((0, 2))
    )
    if len(centre) < 2:
        faults.add("lane without baseline path", f"{token} has no usable baseline path and is left out")
        return None
    speed = row.get("speed_limit_mps")
    parts = as_multi(shapely.make_valid(shape)).geoms if shape is not None else ()
    polygon: Polygon | None = max(parts, key=lambda part: part.area, default=None)
    return SourceLane(
        token=token,
        is_connector=token.startswith("connector_"),
        centre_m=centre,
        polygon=polygon,
        speed_mps=float(speed) if isinstance(speed, int | float) and 0.0 < speed < 100.0 else None,
    )


def _links(tables: _Tables) -> Iterable[tuple[str, str]]:
    for row in tables.rows["lane_connectors"]:
        yield f"lane_{row.get('exit_lane_fid')}", f"connector_{row.get('fid')}"
        yield f"connector_{row.get('fid')}", f"lane_{row.get('entry_lane_fid')}"
