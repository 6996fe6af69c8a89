"""Import the streets of an OpenStreetMap extract with netconvert, in the frame of an HD map."""

from __future__ import annotations

import shutil
import subprocess
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pyproj
import sumolib
from shapely.geometry import LineString, box

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.core.map_files import load_xml
from advdiff_sumo.maps.build_graph import DEFAULT_LANE_WIDTH_M, permissions
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.netconvert import PRECISION, TIMEOUT_S
from advdiff_sumo.maps.read_net import shape_of
from advdiff_sumo.maps.sumo_files import sumo_home

REMEDY = "give an OpenStreetMap extract (.osm, .osm.xml, .osm.gz) of the map's place"
NO_STREET = "holds no street for cars"
NEAR_M = 100.0  # largest distance of streets from the map; an extract farther away is refused
PREFIX = "osm"  # prefix of the names of all edges and junctions
OPTIONS = (  # options recommended by SUMO's guide to OpenStreetMap data, limited to cars
    *("--offset.disable-normalization", "--geometry.remove", "--roundabouts.guess", "--ramps.guess"),
    *("--junctions.join", "--tls.guess-signals", "--tls.discard-simple", "--tls.join"),
    *("--keep-edges.by-vclass", "passenger", "--no-turnarounds.except-deadend", "--xml-validation", "never"),
    *("--no-warnings", "--prefix", PREFIX, "--precision", PRECISION),
)


@dataclass(frozen=True, eq=False)
class Street:
    """An edge of the extract.

    Attributes:
        id: its name.
        origin: node where it begins.
        target: node where it ends.
        middle_m: (N, 2) line midway between its outermost lanes.
        widths_m: widths of its lanes in SUMO's order (index 0 outermost).
        for_cars: whether cars may use each lane.
        clear_m: first and last arc length of the middle line outside the junctions at its ends.
        row: the edge as netconvert's plain XML.
    """

    id: str
    origin: str
    target: str
    middle_m: FloatArray
    widths_m: tuple[float, ...]
    for_cars: tuple[bool, ...]
    clear_m: tuple[float, float]
    row: ET.Element

    @property
    def width_m(self) -> float:
        """Width of all lanes together in m."""
        return sum(self.widths_m)

    def lane_offsets_m(self, lefthand: bool) -> list[float]:
        """Return the lateral offset in m of each lane's centre from the middle line, left positive."""
        inward = np.cumsum(self.widths_m) - 0.5 * np.array(self.widths_m) - 0.5 * self.width_m
        return [float(value) for value in (-inward if lefthand else inward)]


@dataclass(frozen=True, eq=False)
class StreetNet:
    """The streets of an extract as netconvert's plain XML.

    Attributes:
        path: the extract.
        streets: edges by name.
        nodes: rows of nodes by name.
        connections: rows of connections.
        roundabouts: rows of roundabouts.
        neighbours: for each node, the nodes to which a street leads from it or from which one leads to it.
    """

    path: Path
    streets: Mapping[str, Street]
    nodes: Mapping[str, ET.Element]
    connections: tuple[ET.Element, ...]
    roundabouts: tuple[ET.Element, ...]
    neighbours: Mapping[str, set[str]] = field(init=False)

    def __post_init__(self) -> None:
        neighbours: dict[str, set[str]] = defaultdict(set)
        for street in self.streets.values():
            neighbours[street.origin].add(street.target)
            neighbours[street.target].add(street.origin)
        object.__setattr__(self, "neighbours", neighbours)

    def is_dead_end(self, node: str) -> bool:
        """Return whether *node* has at most one neighbour."""
        return len(self.neighbours[node]) < 2


def import_streets(
    path: Path, projection: str | None, bounds_m: FloatArray, folder: Path, *, lefthand: bool
) -> StreetNet:
    """Return the streets for cars in the OpenStreetMap file at *path*, in the frame of the HD map.

    Args:
        path: the extract.
        projection: PROJ string of the HD map's frame.
        bounds_m: (2, 2) lower left and upper right corner of the HD map.
        folder: folder into which netconvert writes.
        lefthand: whether traffic keeps left.

    Raises:
        MapError: the file cannot be read, is no OpenStreetMap data, holds no street for cars or lies elsewhere, or
            the projection of the HD map is unknown.
    """
    root = load_xml(path)
    if root.tag != "osm":
        raise MapError(path, f"is no OpenStreetMap data: its root element is <{root.tag}>, not <osm>", REMEDY)
    if projection is None:
        problem = "cannot be joined: the HD map does not say where on earth it lies"
        raise MapError(path, problem, "give a map that does (docs/maps.md lists them), or leave --osm out")
    if root.find("way") is None:
        raise MapError(path, "holds no way", REMEDY)
    net = _read_net(path, _run_netconvert(path, projection, folder, lefthand), lefthand)
    if not net.streets:
        raise MapError(path, NO_STREET, REMEDY)
    _refuse_elsewhere(net, projection, bounds_m)
    return net


def _run_netconvert(path: Path, projection: str, folder: Path, lefthand: bool) -> Path:
    """Run netconvert; return the path prefix of the plain XML that it wrote."""
    prefix, extract = folder / "streets", folder / f"extract{path.suffix}"
    shutil.copyfile(path, extract)  # netconvert splits a path at commas
    types = sumo_home() / "data" / "typemap" / "osmNetconvert.typ.xml"
    command = [
        *(sumolib.checkBinary("netconvert"), "--osm-files", str(extract), "--type-files", str(types)),
        *(*OPTIONS, "--proj", projection, "--lefthand", str(lefthand).lower()),
        *("--plain-output-prefix", str(prefix), "--output-file", str(folder / "streets.net.xml")),
    ]
    result = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    if result.returncode != 0 or not prefix.with_name("streets.edg.xml").exists():
        errors = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
        reason = errors[0].removeprefix("Error: ").rstrip(".") if errors else "netconvert failed"
        empty = reason in ("No edges loaded", "No nodes loaded")
        raise MapError(path, NO_STREET if empty else f"cannot be imported: {reason}", REMEDY)
    return prefix


def _read_net(path: Path, prefix: Path, lefthand: bool) -> StreetNet:
    """Read the plain XML and the net at *prefix*; streets without a lane for cars are left out."""
    nodes, edges, connections = (
        ET.parse(prefix.with_name(f"{prefix.name}.{kind}.xml")).getroot()  # noqa: S314 - netconvert wrote it
        for kind in ("nod", "edg", "con")
    )
    node_of = {row.attrib["id"]: row for row in nodes.iterfind("node")}
    net = ET.parse(prefix.with_name(f"{prefix.name}.net.xml")).getroot()  # noqa: S314 - the same
    lanes_of = {
        row.get("id"): [shape_of(lane) for lane in row.iterfind("lane")] for row in net.iterfind("edge")
    }
    streets = (
        _street(row, line, lanes_of[row.get("id")], lefthand)
        for row in edges.iterfind("edge")
        if row.get("id") in lanes_of and np.isfinite(line := _drawn_line(row, node_of)).all()
    )
    return StreetNet(
        path,
        {street.id: street for street in streets if any(street.for_cars)},
        node_of,
        tuple(row for row in connections.iterfind("connection") if row.get("to")),
        tuple(edges.iterfind("roundabout")),
    )


def _drawn_line(row: ET.Element, nodes: Mapping[str, ET.Element]) -> FloatArray:
    """Return the shape (N, 2) of the edge *row*, or the line between its nodes if it has none."""
    line = shape_of(row)
    if len(line):
        return line
    ends = (nodes[row.attrib[end]] for end in ("from", "to"))
    return np.array([[float(node.attrib[axis]) for axis in "xy"] for node in ends])


def _street(row: ET.Element, line: FloatArray, lanes_m: Sequence[FloatArray], lefthand: bool) -> Street:
    """Return the street of the edge *row* with shape *line* (N, 2) and lane shapes *lanes_m* in the net."""
    lane_rows = {int(lane.attrib["index"]): lane for lane in row.iterfind("lane")}
    lanes = [lane_rows.get(index, row) for index in range(int(row.attrib["numLanes"]))]
    widths = tuple(float(lane.get("width") or row.get("width") or DEFAULT_LANE_WIDTH_M) for lane in lanes)
    if row.get("spreadType", "right") == "right":
        line = offset_left(line, 0.5 * sum(widths) * (1.0 if lefthand else -1.0))
    starts, ends = (polyline.project(line, np.array([lane[k] for lane in lanes_m]))[0] for k in (0, -1))
    return Street(
        row.attrib["id"],
        row.attrib["from"],
        row.attrib["to"],
        line,
        widths,
        tuple(_for_cars(lane, row) for lane in lanes),
        (float(starts.max()), float(ends.min())),
        row,
    )


def _for_cars(lane: ET.Element, row: ET.Element) -> bool:
    """Return whether cars may use *lane* of the edge *row*."""
    rules = lane if lane.get("allow") or lane.get("disallow") else row
    return "passenger" in permissions(rules.get("allow"), rules.get("disallow"))


def offset_left(line: FloatArray, left_m: float) -> FloatArray:
    """Return *line* (N, 2) moved to its left by *left_m*, or unchanged if that leaves no single line."""
    moved = LineString(line).offset_curve(left_m, join_style="mitre")
    return np.asarray(moved.coords) if isinstance(moved, LineString) and not moved.is_empty else line


def _refuse_elsewhere(net: StreetNet, projection: str, bounds_m: FloatArray) -> None:
    """Raise a MapError if no street of the extract is near the HD map with corners *bounds_m* (2, 2)."""
    surroundings = box(*(bounds_m[0] - NEAR_M), *(bounds_m[1] + NEAR_M))
    if any(LineString(street.middle_m).intersects(surroundings) for street in net.streets.values()):
        return
    middle = np.mean([street.middle_m[0] for street in net.streets.values()], axis=0)
    x_m, y_m = np.array([middle, bounds_m.mean(axis=0)]).T
    lon_deg, lat_deg = pyproj.Proj(projection)(x_m, y_m, inverse=True)
    streets, hd_map = (f"latitude {y:.4f}, longitude {x:.4f}" for x, y in zip(lon_deg, lat_deg, strict=True))
    raise MapError(net.path, f"lies elsewhere: streets near {streets}, the HD map near {hd_map}", REMEDY)
