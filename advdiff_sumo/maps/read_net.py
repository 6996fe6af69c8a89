"""Reads the XML elements of a SUMO net file.

sumolib's reader cannot be used: it ignores left-hand traffic, does not check that the file is a net, and keeps the
right-of-way matrix private. The tests compare the result with sumolib's. External entities are refused (defusedxml).
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
from advdiff_sumo.maps.lanes import edge_of_lane
from advdiff_sumo.maps.not_a_net import map_error

SUFFIXES = (".net.xml.gz", ".net.xml", ".xml.gz", ".xml")
BEYOND_TYPE = "beyond_rim"
"""Type of the edges that lead vehicles from the exits of a clipped map back to its entries; they are not measured."""
_KEPT_FUNCTIONS = ("", "normal", "internal")


@dataclass(frozen=True)
class Location:
    """The geographic reference of a net.

    Attributes:
        offset_xy_m: (2,) offset that was added to the projected coordinates.
        proj: PROJ string; None if the net has no projection.
    """

    offset_xy_m: FloatArray
    proj: str | None


@dataclass(frozen=True)
class RawNet:
    """The XML elements of a net file that a road map needs. Edges beyond the rim: see :data:`BEYOND_TYPE`.

    Attributes:
        path: the file.
        lefthand: whether traffic drives on the left.
        location: geographic reference.
        edges: id → element with its lanes; without crossings and walking areas.
        junctions: id → element with its requests; without internal junctions and those beyond the rim.
        connections: elements in file order, without those of crossings and walking areas.
        counted: *connections* and those to and from edges beyond the rim, which have right-of-way rows too.
        pedestrian_shapes: id → shape (K, 2): the centre line of a crossing, the outline of a walking area.
        beyond_rim: ids of the edges beyond the rim and of the internal edges to and from them. The other fields,
            apart from *counted*, do not contain them.
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
        NetError: the file is missing, unreadable, truncated or no SUMO net; for an HD map, the error names the
            command that converts it.
    """
    try:
        root = read_root(path, "net", "a SUMO net")
    except NetError as error:
        raise map_error(path) or error from None
    edges: dict[str, ET.Element] = {}
    pedestrian_shapes: dict[str, FloatArray] = {}
    beyond = ids_beyond(root)
    for edge in root.iterfind("edge"):
        lane = edge.find("lane")
        if edge.get("id") in beyond:
            continue
        if edge.get("function", "") in _KEPT_FUNCTIONS and lane is not None:
            edges[edge.get("id", "")] = edge
        elif edge.get("function") in ("crossing", "walkingarea") and lane is not None:
            pedestrian_shapes[edge.get("id", "")] = read_only(shape_of(lane))
    known_ids = edges.keys() | beyond
    counted = [
        c for c in root.iterfind("connection") if c.get("from") in known_ids and c.get("to") in known_ids
    ]
    return RawNet(
        path=path,
        lefthand=root.get("lefthand", "false").lower() in ("true", "1"),
        location=_location(root.find("location")),
        edges=edges,
        junctions=_junctions(root, beyond, edges),
        connections=tuple(c for c in counted if c.get("from") in edges and c.get("to") in edges),
        counted=tuple(counted),
        pedestrian_shapes=pedestrian_shapes,
        beyond_rim=frozenset(beyond),
    )


def _junctions(
    root: ET.Element, beyond: Collection[str], edges: Mapping[str, ET.Element]
) -> dict[str, ET.Element]:
    """Return id → junction, without internal junctions and those at which only edges *beyond* the rim meet."""
    junctions = {j.get("id", ""): j for j in root.iterfind("junction") if j.get("type") != "internal"}
    if not beyond:
        return junctions
    end_ids = {edge.get(end) for edge in edges.values() for end in ("from", "to")}
    return {name: junction for name, junction in junctions.items() if name in end_ids}


def leaving_lanes(connections: Iterable[ET.Element]) -> defaultdict[str, list[ET.Element]]:
    """Return lane id → the *connections* that leave it, in the given order; an empty list for other lanes."""
    leaving = defaultdict[str, list[ET.Element]](list)
    for connection in connections:
        leaving[f"{connection.attrib['from']}_{connection.attrib['fromLane']}"].append(connection)
    return leaving


def ids_beyond(root: ET.Element) -> set[str]:
    """Return the ids of the edges beyond the rim (:data:`BEYOND_TYPE`) and of the internal edges to and from them."""
    edges = {edge.get("id", "") for edge in root.iterfind("edge") if edge.get("type") == BEYOND_TYPE}
    if not edges:
        return edges
    connections = [c for c in root.iterfind("connection") if c.get("from") in edges or c.get("to") in edges]
    return edges | {edge_of_lane(c.get("via", "")) for c in connections}


def read_root(path: Path, tag: str, what: str) -> ET.Element:
    """Return the root element of an XML file.

    Args:
        path: the file, gzipped or not.
        tag: required name of the root element.
        what: description of such a file, for messages.

    Raises:
        NetError: the file is missing, unreadable or damaged, or its root element has another name.
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
    """Return the indices of the ones in a *row* of foes or responses; SUMO writes index 0 rightmost."""
    return frozenset(index for index, bit in enumerate(reversed(row)) if bit == "1")


def shape_of(element: ET.Element) -> FloatArray:
    """Return the ``shape`` of *element* as points (P, 2) without heights; (0, 2) if it has none."""
    return points_of(element.get("shape", ""))


def points_of(text: str) -> FloatArray:
    """Return the points (P, 2) of a shape "x,y x,y …" of SUMO, without heights; (0, 2) if it is empty."""
    points = [point.split(",")[:2] for point in text.split()]
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
