"""Map files that no reader can use, by their fault."""

from __future__ import annotations

import json
import math
import os
import pickle
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import shapely
import small_sources
from shapely.geometry import Point, box
from test_bad_formats import text_of

Write = Callable[[Path], object]
NAMES = {
    "argoverse2": "bad.json",
    "commonroad": "bad.xml",
    "lanelet2": "bad.osm",
    "nuplan": "map.gpkg",
    "nuscenes": "bad.json",
    "opendrive": "bad.xodr",
    "scenarionet": "bad.pkl",
}
XML = ("commonroad", "lanelet2", "opendrive")


@dataclass(frozen=True)
class Malformed:
    """A file of one *kind* of map, and the function that writes it."""

    kind: str
    fault: str
    write: Write

    def put(self, folder: Path) -> Path:
        """Write the file into *folder* and return its path."""
        self.write(path := folder / NAMES[self.kind])
        return path


def malformed(folder: Path) -> Iterator[Malformed]:
    """Yield the files of every kind; complete files, of which some are fragments, are made in *folder*."""
    for kind in NAMES:
        for fault, content in (*_of_other_formats(kind), *_texts(kind, folder)):
            yield Malformed(kind, fault, lambda path, content=content: path.write_bytes(content))
        yield Malformed(kind, "a folder", Path.mkdir)
        yield Malformed(kind, "over a gigabyte", _gigabyte)
    for fault, statements in _SPOILED_LAYERS.items():
        yield Malformed("nuplan", fault, lambda path, statements=statements: _spoil(path, statements))
    for fault, damage in _SPOILED_BYTES.items():
        yield Malformed("nuplan", fault, lambda path, damage=damage: _damage(path, damage))


def _gigabyte(path: Path) -> None:
    with path.open("wb") as file:
        os.truncate(file.fileno(), 1_100_000_000)  # sparse: takes no space


def _of_other_formats(kind: str) -> Iterator[tuple[str, bytes]]:
    yield "empty", b""
    yield "blank", b"  \n"
    yield "binary", bytes(range(256))
    yield "zeros", b"\x00" * 1000
    yield "a list", b"[]"
    yield "a number", b"3"
    yield "null", b"null"
    yield "text", b'"map"'
    yield "deep", b"[" * 100_000
    yield "HTML", b"<html><body>404 Not Found</body></html>"
    yield "LFS pointer", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12345\n"
    yield "entity bomb", b'<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><commonRoad>&b;</commonRoad>'
    yield "of another root", b"<net version='1.9'></net>"
    if kind in XML:
        yield "of an unknown encoding", b'<?xml version="1.0" encoding="x"?><osm version="0.6"/>'


def _whole(kind: str, folder: Path) -> str:
    if kind == "nuscenes":
        return '{"version": "1.3", "lane": [{"token": "a"}], "node": [], "polygon": []}'
    return text_of(kind, folder)[1]


def _texts(kind: str, folder: Path) -> Iterator[tuple[str, bytes]]:
    if kind == "nuplan":
        return
    if kind == "scenarionet":
        yield from _pickles()
        return
    whole = _whole(kind, folder)
    yield "not UTF-8", whole.encode().replace(b"1", b"\xff\xfe")
    yield "cut in the middle", whole[: len(whole) // 2].encode()
    yield "without its end", whole[:-2].encode()
    yield "twice", 2 * whole.encode()
    if kind in XML:  # which may be in UTF-16
        for fault, old, new in _REPLACED[kind]:
            assert old in whole
            yield fault, whole.replace(old, new).encode()
        return
    yield "UTF-16", whole.encode("utf-16")
    data = json.loads(whole)
    for layer in list(data):
        yield f"without {layer}", json.dumps({k: v for k, v in data.items() if k != layer}).encode()
        yield f"{layer} of another type", json.dumps({**data, layer: 7}).encode()
        yield f"{layer} null", json.dumps({**data, layer: None}).encode()


_REPLACED = {
    "commonroad": (
        ("no version", ' commonRoadVersion="2020a"', ""),
        ("version 1", "2020a", "1.0"),
        ("no lanelet", "lanelet", "lane"),
        ("no bounds", "leftBound", "leftSide"),
        ("no numbers", "<x>", "<x>east"),
        ("NaN", "<x>", "<x>nan</x><x>"),
    ),
    "lanelet2": (
        ("no lanelet", 'v="lanelet"', 'v="multipolygon"'),
        ("no boundary", 'role="left"', 'role="side"'),
        ("no nodes", "<node ", "<place "),
        ("dangling nodes", '<nd ref="', '<nd ref="7'),
        ("NaN", 'k="local_x" v="', 'k="local_x" v="nan" w="'),
    ),
    "opendrive": (
        ("no road", "<road ", "<street "),
        ("no plan view", "planView", "plan"),
        ("no lane section", "laneSection", "section"),
        ("no lane for vehicles", 'type="driving"', 'type="shoulder"'),
        ("no width", "<width ", "<breadth "),
        ("width NaN", '<width sOffset="0" a="', '<width sOffset="0" a="nan" x="'),
        ("length infinite", ' length="', ' length="inf" of="'),
        ("start NaN", ' hdg="', ' hdg="nan" of="'),
    ),
}


class _Command:
    """An object that a pickle must not contain: loading it calls a function."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("true",)


def _pickles() -> Iterator[tuple[str, bytes]]:
    whole = pickle.dumps({"map_features": {}, "metadata": {}})
    yield "no lane", whole
    yield "cut", whole[:-5]
    yield "a command", pickle.dumps(_Command())
    features = {"1": {"type": "LANE_FREEWAY"}, "2": {"type": "LANE_FREEWAY", "polyline": "x"}}
    yield "no centre line", pickle.dumps({"map_features": features})
    yield "features of another type", pickle.dumps({"map_features": 7})
    yield "None", pickle.dumps(None)


def _geometry(shape: shapely.Geometry) -> str:
    """Return a geometry of a GeoPackage, without envelope, as SQL."""
    return (
        f"x'{(b'GP' + bytes((0, 1)) + struct.pack('<i', 4326) + shapely.to_wkb(shape, byte_order=1)).hex()}'"
    )


def _line(x_deg: float) -> str:
    """Return a line from 117° west to *x_deg* as SQL; shapely warns of NaN."""
    header = b"GP" + bytes((0, 1)) + struct.pack("<i", 4326)
    return f"x'{(header + struct.pack('<BII4d', 1, 2, 2, -117.0, 36.1, x_deg, 36.1)).hex()}'"


def _set(layer: str, column: str, value: str) -> str:
    return f"UPDATE {layer} SET {column} = {value}"  # noqa: S608 - our own names


_SPOILED_LAYERS = {
    **{
        f"without layer {layer}": f"DROP TABLE {layer}"
        for layer in ("meta", "baseline_paths", "lanes_polygons", "lane_connectors")
    },
    **{
        f"{layer} without column {column}": f"ALTER TABLE {layer} RENAME COLUMN {column} TO other"
        for layer, column in (
            ("meta", "key"),
            ("meta", "value"),
            ("baseline_paths", "lane_fid"),
            ("baseline_paths", "lane_connector_fid"),
            ("baseline_paths", "geom"),
            ("lanes_polygons", "lane_fid"),
            ("lane_connectors", "fid"),
            ("lane_connectors", "exit_lane_fid"),
            ("lane_connectors", "entry_lane_fid"),
        )
    },
    "meta empty": "DELETE FROM meta",
    "baseline_paths empty": "DELETE FROM baseline_paths",
    "no lanes": "DELETE FROM lanes_polygons; DELETE FROM lane_connectors",
    **{
        f"system {name}": _set("meta", "value", value)
        for name, value in {
            "null": "NULL",
            "of a number": "7",
            "unknown": "'EPSG:999999'",
            "of text": "'somewhere\nelse'",
            "of degrees": "'EPSG:4326'",
            "of feet": "'EPSG:2263'",
            "of bytes": "x'0001'",
        }.items()
    },
    **{
        f"shapes {name}": _set("baseline_paths", "geom", value)
        for name, value in {
            "null": "NULL",
            "of text": "'LINESTRING (0 0, 1 1)'",
            "of numbers": "3.5",
            "of no bytes": "x''",
            "with a header alone": "x'47500001E6100000'",
            "cut": "substr(geom, 1, 60)",
            "without header": "substr(geom, 41)",
            "of an unknown type": "x'47500001E610000001FF000000'",
            "of points": _geometry(Point(-117.0, 36.1)),
            "of areas": _geometry(box(-117.0, 36.0, -116.9, 36.1)),
            "of empty lines": _geometry(shapely.LineString()),
            "with NaN": _line(math.nan),
            "with infinity": _line(math.inf),
            "with 1e308": _line(1e308),
            "round the earth": _line(100.0),
            "without length": _line(-117.0),
        }.items()
    },
    "lanes without id": "UPDATE lanes_polygons SET lane_fid = NULL; DELETE FROM lane_connectors",
    "paths without id": "UPDATE baseline_paths SET lane_fid = NULL, lane_connector_fid = NULL",
    "paths of unknown lanes": "UPDATE baseline_paths SET lane_fid = 'x', lane_connector_fid = 'y'",
}


def _spoil(path: Path, statements: str) -> None:
    small_sources.nuplan(path)
    with closing(sqlite3.connect(path)) as base, base:
        base.executescript(statements)


_SPOILED_BYTES: dict[str, Callable[[bytes], bytes]] = {
    "of 100 bytes": lambda whole: whole[:100],
    "of one page": lambda whole: whole[:4096],
    "cut in the middle": lambda whole: whole[: len(whole) // 2],
    "with another first line": lambda whole: b"SQLite format 2\x00" + whole[16:],
    "with pages of 0 bytes": lambda whole: whole[:16] + b"\x00\x00" + whole[18:],
    "with a spoiled list of tables": lambda whole: whole[:100] + b"\xff" * 3996 + whole[4096:],
    "with spoiled tables": lambda whole: whole[:4096] + b"\xa5" * (len(whole) - 4096),
}


def _damage(path: Path, damage: Callable[[bytes], bytes]) -> None:
    small_sources.nuplan(path)
    path.write_bytes(damage(path.read_bytes()))
