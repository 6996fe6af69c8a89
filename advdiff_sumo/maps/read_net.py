"""Reads a SUMO net file into plain values, in one pass.

sumolib's reader leaves out what is needed here (left-hand driving, a check that the file is a net at all) and
keeps the right-of-way rows private, so the elements are read directly; the tests hold the result against
sumolib's. External entities are refused (defusedxml).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from defusedxml.ElementTree import parse as parse_xml

from advdiff_sumo.core.arrays import FloatArray, read_only
from advdiff_sumo.core.errors import NetError, os_reason
from advdiff_sumo.core.gzipped import DAMAGED_GZIP, GZIP_PROBLEM, GZIP_REMEDY, unpacked
from advdiff_sumo.core.xml_errors import UNREADABLE_XML
from advdiff_sumo.maps.not_a_net import map_error

SUFFIXES = (".net.xml.gz", ".net.xml", ".xml.gz", ".xml")
BEYOND_TYPE = "beyond_rim"
"""Type of the edges that lead from where a clipped map ends to where it begins; nothing is measured on them."""
_KEPT_FUNCTIONS = ("", "normal", "internal")


@dataclass(frozen=True)
class Location:
    """How the net's metres relate to the globe.

    Attributes:
        offset_xy_m: (2,) added to projected coordinates.
        proj: PROJ string, or None when the net has no projection.
    """

    offset_xy_m: FloatArray
    proj: str | None


@dataclass(frozen=True)
class RawNet:
    """The elements of a net file that a road map needs, still XML.

    Attributes:
        path: the file.
        lefthand: whether traffic drives on the left.
        location: how the metres relate to the globe.
        edges: id → element with its lanes; crossings and walking areas are left out.
        junctions: id → element with its requests; internal junctions and those beyond the rim are left out.
        connections: elements in file order, those of crossings and walking areas left out.
        counted: the same with those to and from edges beyond the rim, which have rows in the right of way, too.
        pedestrian_shapes: id → outline (K, 2) of crossings (as a line) and walking areas.
        beyond_rim: ids of the edges beyond the rim, ways to and from them among them, which are in none of these.
    """

    path: Path
    lefthand: bool
    location: Location
    edges: Mapping[str, ET.Element]
    junctions: Mapping[str, ET.Element]
    connections: tuple[ET.Element, ...]
    counted: tuple[ET.Element, ...]
    pedestrian_shapes: Mapping[str, FloatArray]
    beyond_rim: frozenset[str]


def read_raw_net(path: Path) -> RawNet:
    """Return the elements of the net at *path* (plain or gzipped).

    Raises:
        NetError: the file is missing, unreadable, truncated or no SUMO net; of a map with the command that converts it.
    """
    try:
        root = read_root(path, "net", "a SUMO net")
    except NetError as error:
        raise map_error(path) or error from None
    edges: dict[str, ET.Element] = {}
    pedestrian: dict[str, FloatArray] = {}
    beyond = ids_beyond(root)
    for edge in root.iterfind("edge"):
        lane = edge.find("lane")
        if edge.get("id") in beyond:
            continue
        if edge.get("function", "") in _KEPT_FUNCTIONS and lane is not None:
            edges[edge.get("id", "")] = edge
        elif edge.get("function") in ("crossing", "walkingarea") and lane is not None:
            pedestrian[edge.get("id", "")] = read_only(shape_of(lane))
    known = edges.keys() | beyond
    counted = [c for c in root.iterfind("connection") if c.get("from") in known and c.get("to") in known]
    return RawNet(
        path=path,
        lefthand=root.get("lefthand", "false").lower() in ("true", "1"),
        location=_location(root.find("location")),
        edges=edges,
        junctions=_junctions(root, beyond, edges),
        connections=tuple(c for c in counted if c.get("from") in edges and c.get("to") in edges),
        counted=tuple(counted),
        pedestrian_shapes=pedestrian,
        beyond_rim=frozenset(beyond),
    )


def _junctions(
    root: ET.Element, beyond: Collection[str], edges: Mapping[str, ET.Element]
) -> dict[str, ET.Element]:
    """Return the junctions of a net by name, without those at which only edges *beyond* the rim meet."""
    rows = {j.get("id", ""): j for j in root.iterfind("junction") if j.get("type") != "internal"}
    if not beyond:
        return rows
    on_map = {edge.get(end) for edge in edges.values() for end in ("from", "to")}
    return {name: row for name, row in rows.items() if name in on_map}


def leaving_lanes(connections: Iterable[ET.Element]) -> defaultdict[str, list[ET.Element]]:
    """Return lane → its *connections*, in their order; none for other lanes."""
    leaving = defaultdict[str, list[ET.Element]](list)
    for connection in connections:
        leaving[f"{connection.attrib['from']}_{connection.attrib['fromLane']}"].append(connection)
    return leaving


def ids_beyond(root: ET.Element) -> set[str]:
    """Return the edges beyond the rim of a net (:data:`BEYOND_TYPE`), ways to and from them among them."""
    edges = {edge.get("id", "") for edge in root.iterfind("edge") if edge.get("type") == BEYOND_TYPE}
    if not edges:
        return edges
    ways = [c for c in root.iterfind("connection") if c.get("from") in edges or c.get("to") in edges]
    return edges | {c.get("via", "").rpartition("_")[0] for c in ways}


def read_root(path: Path, tag: str, what: str) -> ET.Element:
    """Return the root element of the XML file at *path* (gzipped or not), which must be named *tag*.

    Raises:
        NetError: with one sentence that says what is wrong with the file.
    """
    try:
        root = _parse(path)
    except FileNotFoundError:
        raise NetError(path, "no such file", f"give the path of {what}") from None
    except IsADirectoryError:
        raise NetError(path, "is a folder", f"give the path of {what} inside it") from None
    except DAMAGED_GZIP:
        raise NetError(path, GZIP_PROBLEM, GZIP_REMEDY) from None
    except OSError as error:
        raise NetError(path, f"cannot be read ({os_reason(error)})") from None
    except UNREADABLE_XML as error:
        remedy = "it is truncated or not XML; copy or make it anew"
        raise NetError(path, f"is not readable as XML ({error})", remedy) from None
    if root.tag != tag:
        problem = f"is not {what}: its root element is <{root.tag}>, not <{tag}>"
        raise NetError(path, problem, f"give the path of {what}")
    return root


def _parse(path: Path) -> ET.Element:
    with unpacked(path) as file:
        root: ET.Element | None = parse_xml(file).getroot()
    if root is None:
        raise ET.ParseError("no element found")
    return root


def marked_requests(row: str) -> frozenset[int]:
    """Return the requests with a one in a *row* of foes or responses; SUMO writes index 0 rightmost."""
    return frozenset(index for index, bit in enumerate(reversed(row)) if bit == "1")


def shape_of(element: ET.Element) -> FloatArray:
    """Return the ``shape`` of *element* as (P, 2) points, heights dropped; (0, 2) when it has none."""
    points = [point.split(",")[:2] for point in element.get("shape", "").split()]
    return np.array(points, dtype=np.float64).reshape(-1, 2)


def _location(element: ET.Element | None) -> Location:
    if element is None:
        return Location(np.zeros(2), None)
    x, y = element.get("netOffset", "0,0").split(",")[:2]
    proj = element.get("projParameter", "!")
    return Location(np.array([float(x), float(y)]), None if proj in ("!", "-", "") else proj)


def base_name(path: Path) -> str:
    """Return the file's name without its SUMO suffixes."""
    for suffix in SUFFIXES:
        if path.name.endswith(suffix):
            return path.name.removesuffix(suffix)
    return path.stem
