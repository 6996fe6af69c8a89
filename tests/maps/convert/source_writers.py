"""Write any map in the formats of nuPlan and Lanelet2, for large samples of formats without real files here."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pyproj
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import stations_m
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.layout.joints import Joints
from advdiff_sumo.maps.convert.sources.source_map import SourceLane, SourceMap

HALF_M = 1.75
UTM_M = (456_000.0, 5_428_000.0)  # where (0, 0) lies in zone 32
SRS_NUMBER = 4326
TYPES = {"fid": "INTEGER", "speed_limit_mps": "REAL", "geom": "BLOB"}
# The tables that the standard requires (OGC 12-128r19, annex C), without those of absent layers.
GEOPACKAGE = """
PRAGMA application_id = 1196444487;
PRAGMA user_version = 10200;
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME DEFAULT '2021-01-01T00:00:00.000Z', min_x DOUBLE, min_y DOUBLE,
  max_x DOUBLE, max_y DOUBLE, srs_id INTEGER);
CREATE TABLE gpkg_geometry_columns (table_name TEXT PRIMARY KEY, column_name TEXT NOT NULL,
  geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL);
"""
Row = dict[str, Any]


def sides(centre_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the left and right boundary (N, 2) of a lane of 3.5 m."""
    yaw = polyline.heading(centre_m, stations_m(centre_m))
    across = HALF_M * np.stack((-np.sin(yaw), np.cos(yaw)), axis=-1)
    return centre_m + across, centre_m - across


def write_nuplan(source: SourceMap, path: Path, zone: str = "EPSG:32611") -> None:
    """Write the lanes and links of *source* as a nuPlan map: lanes are numbered, connectors join one to one."""
    number = {lane.token: str(index + 1) for index, lane in enumerate(source.lanes)}
    before = {b: number[a] for a, b in source.links}
    after = {a: number[b] for a, b in source.links}
    layers: dict[str, list[Row]] = {
        name: [] for name in ("baseline_paths", "lanes_polygons", "lane_connectors", "generic_drivable_areas")
    }
    for lane in source.lanes:
        left, right = sides(lane.centre_m)
        line, ring = shapely.LineString(lane.centre_m), shapely.Polygon(np.vstack((left, right[::-1])))
        name, limit = number[lane.token], lane.speed_mps or 13.4
        if lane.is_connector and not (lane.token in before and lane.token in after):
            continue
        key, other = (
            ("lane_connector_fid", "lane_fid") if lane.is_connector else ("lane_fid", "lane_connector_fid")
        )
        layers["baseline_paths"].append({key: name, other: None, "geom": line})
        layers["generic_drivable_areas"].append({"geom": ring.buffer(0.0)})
        if lane.is_connector:
            ends = {"exit_lane_fid": before[lane.token], "entry_lane_fid": after[lane.token]}
            layers["lane_connectors"].append(
                {"fid": int(name), **ends, "speed_limit_mps": limit, "geom": line}
            )
        else:
            layers["lanes_polygons"].append(
                {"lane_fid": name, "speed_limit_mps": limit, "geom": ring.buffer(0.0)}
            )
    write_geopackage(path, layers, zone)


def write_geopackage(path: Path, layers: dict[str, list[Row]], zone: str) -> None:
    """Write *layers*, in m about (500000, 4000000) of *zone*, as a GeoPackage in degrees, and the layer ``meta``."""
    back = pyproj.Transformer.from_crs(zone, "EPSG:4326", always_xy=True)

    def to_degrees(xy: FloatArray) -> FloatArray:
        return np.stack(back.transform(xy[:, 0] + 5e5, xy[:, 1] + 4e6), axis=-1)

    with closing(sqlite3.connect(path)) as base, base:
        base.executescript(GEOPACKAGE)
        base.execute(
            "INSERT INTO gpkg_spatial_ref_sys VALUES ('WGS 84', ?, 'EPSG', ?, ?, NULL)",
            (SRS_NUMBER, SRS_NUMBER, pyproj.CRS(SRS_NUMBER).to_wkt("WKT1_GDAL")),
        )
        _table(base, "meta", [{"key": "projectedCoordSystem", "value": zone}])
        for name, rows in layers.items():
            _table(
                base,
                name,
                [{**row, "geom": _blob(shapely.transform(row["geom"], to_degrees))} for row in rows],
            )


def _table(base: sqlite3.Connection, name: str, rows: Sequence[Row]) -> None:
    columns = [column for column in rows[0] if column != "fid"]
    types = ", ".join(f"{column} {TYPES.get(column, 'TEXT')}" for column in columns)
    base.execute(f"CREATE TABLE {name} (fid INTEGER PRIMARY KEY AUTOINCREMENT, {types})")
    for row in rows:
        marks = ", ".join("?" * (len(columns) + 1))
        base.execute(f"INSERT INTO {name} VALUES ({marks})", [row.get("fid"), *(row[c] for c in columns)])  # noqa: S608 - our own names
    kind = "features" if "geom" in columns else "attributes"
    base.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, srs_id) VALUES (?, ?, ?)", (name, kind, SRS_NUMBER)
    )
    if kind == "features":
        row = (name, "geom", "GEOMETRY", SRS_NUMBER, 0, 0)
        base.execute("INSERT INTO gpkg_geometry_columns VALUES (?, ?, ?, ?, ?, ?)", row)


def _blob(shape: shapely.Geometry) -> bytes:
    """Return a geometry with the header of a GeoPackage, its envelope included."""
    west, south, east, north = shape.bounds
    header = b"GP" + bytes((0, 0b11)) + struct.pack("<i4d", SRS_NUMBER, west, east, south, north)
    return header + bytes(shapely.to_wkb(shape, byte_order=1))


def write_lanelet2(source: SourceMap, path: Path, *, uneven: bool = False) -> None:
    """Write the lanes of *source* as lanelets in degrees; linked ones share nodes.

    With *uneven*, the left boundary keeps every second of its inner points, the right one every third.
    """
    number = {lane.token: index + 1 for index, lane in enumerate(source.lanes)}
    joints = Joints()
    for a, b in source.links:
        joints.join(((a, -1), (b, 0)))
    bounds = {lane.token: sides(lane.centre_m) for lane in source.lanes}
    ends: dict[Any, list[FloatArray]] = {}
    for lane in source.lanes:
        for end in (0, -1):
            pair = np.stack([side[end] for side in bounds[lane.token]])
            ends.setdefault(joints.find((lane.token, end)), []).append(pair)
    nodes: list[FloatArray] = []
    shared: dict[Any, tuple[int, int]] = {}
    for joint, pairs in ends.items():
        shared[joint] = (len(nodes) + 1, len(nodes) + 2)
        nodes += list(np.mean(pairs, axis=0))
    root = ET.Element("osm", version="0.6")
    ways, relations = [], []
    for lane in source.lanes:
        first, last = (shared[joints.find((lane.token, end))] for end in (0, -1))
        for side, name in enumerate(("left", "right")):
            inner = bounds[lane.token][side][1:-1][:: 2 + side if uneven else 1]
            refs = [first[side], *range(len(nodes) + 1, len(nodes) + 1 + len(inner)), last[side]]
            nodes += list(inner)
            way = ET.Element("way", id=str(_way(number[lane.token], name)))
            way.extend(ET.Element("nd", ref=str(ref)) for ref in refs)
            way.extend(_tags(type="line_thin", subtype="dashed"))
            ways.append(way)
        relations.append(_lanelet(lane, number[lane.token]))
    root.extend([*_nodes(nodes), *ways, *relations])
    ET.ElementTree(root).write(path, encoding="utf-8")


def _way(lane: int, side: str) -> int:
    return 10 * lane + (1 if side == "left" else 2)


def _lanelet(lane: SourceLane, number: int) -> ET.Element:
    row = ET.Element("relation", id=str(number))
    for side in ("left", "right"):
        ET.SubElement(row, "member", type="way", ref=str(_way(number, side)), role=side)
    row.extend(_tags(type="lanelet", subtype="road", location="urban", one_way="yes", speed_limit="50 km/h"))
    if lane.is_connector:
        row.extend(_tags(turn_direction="straight"))
    return row


def _nodes(places: Iterable[FloatArray]) -> Iterator[ET.Element]:
    back = pyproj.Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True)
    lon, lat = back.transform(*(np.array(list(places)) + UTM_M).T)
    for index, (x, y) in enumerate(zip(lon.tolist(), lat.tolist(), strict=True)):
        yield ET.Element("node", id=str(index + 1), lat=repr(y), lon=repr(x))


def _tags(**values: str) -> list[ET.Element]:
    return [ET.Element("tag", k=key, v=value) for key, value in values.items()]
