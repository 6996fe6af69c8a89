"""Builds the geometry of a net's carriageway: its vehicle lanes and the paths through junctions."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import shapely
from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.maps.build_graph import DEFAULT_LANE_WIDTH_M, permissions
from advdiff_sumo.maps.read_net import ids_beyond, leaving_lanes, shape_of

_NOT_ON_WHEELS = frozenset(
    {
        *("pedestrian", "wheelchair", "scooter", "container", "drone", "aircraft", "ship", "cable_car"),
        *("tram", "rail", "rail_urban", "rail_electric", "rail_fast", "subway"),
    }
)
"""SUMO's vehicle classes that do not drive on a carriageway; some of them may use footways."""
NARROW_M = 1.2  # narrower gaps between lanes are not islands on which pedestrians can stand
_SEGMENTS = 4  # of a quarter circle, where the carriageway is buffered


@dataclass(frozen=True, eq=False)
class Strip:
    """A lane of an edge, or an internal lane, which is a path through a junction.

    Attributes:
        lane: id of the lane.
        line: centre line.
        width_m: width.
        speed_mps: speed limit.
        junction: the junction that an internal lane lies on; "" for a lane of an edge.
        request: row of an internal lane in the junction's right-of-way matrix; -1 for a lane of an edge.
        is_straight: whether an internal lane belongs to a link that goes straight on.
    """

    lane: str
    line: LineString
    width_m: float
    speed_mps: float
    junction: str = ""
    request: int = -1
    is_straight: bool = False


class Carriageway:
    """The vehicle lanes of a net; without edges beyond the rim, footways and rails.

    Attributes:
        root: the net.
        strips: lanes of edges, then internal lanes.
        links: (junction, row in its right-of-way matrix) → connection.
    """

    def __init__(self, root: ET.Element, drivable: BaseGeometry | None = None) -> None:
        """Read the net *root*; the area *drivable* belongs to the carriageway."""
        self.root = root
        self._beyond = ids_beyond(root)
        self.links = _links(root)
        self.strips = (*self._lanes(), *self._internal_lanes())
        self._drivable = drivable
        self._tree = shapely.STRtree([strip.line for strip in self.strips])

    def crossed_by(self, shape: BaseGeometry) -> list[Strip]:
        """Return the strips whose centre lines intersect *shape*."""
        numbers = self._tree.query(shape, predicate="intersects").tolist()
        return [self.strips[number] for number in sorted(numbers)]

    @cached_property
    def area(self) -> BaseGeometry:
        """The area that vehicles may use: lanes, internal lanes and the drivable area."""
        return self.lanes_area if self._drivable is None else _closed([self.lanes_area, self._drivable])

    @cached_property
    def lanes_area(self) -> BaseGeometry:
        """The union of lanes and internal lanes; gaps narrower than an island are closed."""
        return _closed(
            [s.line.buffer(0.5 * s.width_m, cap_style="flat", join_style="mitre") for s in self.strips]
        )

    @cached_property
    def open_ends(self) -> tuple[tuple[Point, float], ...]:
        """End points of lanes that no connection leaves or enters there, each with the lane's width in m."""
        connections = [
            c for c in self.root.iterfind("connection") if not {c.get("from"), c.get("to")} & self._beyond
        ]
        with_exit = {(c.get("from"), c.get("fromLane")) for c in connections}
        with_entry = {(c.get("to"), c.get("toLane")) for c in connections}
        ends = []
        for strip in self.strips:
            key = tuple(strip.lane.rsplit("_", 1))
            if not strip.junction and key not in with_exit:
                ends.append((Point(strip.line.coords[-1]), strip.width_m))
            if not strip.junction and key not in with_entry:
                ends.append((Point(strip.line.coords[0]), strip.width_m))
        return tuple(ends)

    def _lanes(self) -> list[Strip]:
        lanes = (
            lane
            for edge in self.root.iterfind("edge")
            if edge.get("function", "normal") == "normal" and edge.get("id") not in self._beyond
            for lane in edge.iterfind("lane")
        )
        return [_strip(lane) for lane in lanes if _is_for_vehicles(lane)]

    def _internal_lanes(self) -> list[Strip]:
        link_of = {
            via: (junction, request, connection.get("dir") == "s")
            for (junction, request), connection in self.links.items()
            for via in self.parts(connection)
        }
        lanes = (
            lane
            for edge in self.root.iterfind("edge")
            if edge.get("function") == "internal" and edge.get("id") not in self._beyond
            for lane in edge.iterfind("lane")
        )
        return [
            _strip(lane, *link_of[lane.get("id", "")])
            for lane in lanes
            if lane.get("id") in link_of and _is_for_vehicles(lane)
        ]

    @cached_property
    def _second_halves(self) -> dict[str, str]:
        """First internal lane → second one, for links that a waiting position inside the junction divides."""
        connections = (
            c for c in self.root.iterfind("connection") if c.get("from", "").startswith(":") and c.get("via")
        )
        return {f"{c.get('from')}_{c.get('fromLane')}": c.get("via", "") for c in connections}

    def parts(self, connection: ET.Element) -> list[str]:
        """Return the ids of the internal lanes of a connection, in driving order."""
        via = connection.get("via", "")
        vias = [via]
        while via in self._second_halves:
            via = self._second_halves[via]
            vias.append(via)
        return vias


def _closed(parts: Sequence[BaseGeometry]) -> BaseGeometry:
    """Return the union of *parts* with narrow gaps closed."""
    union = shapely.union_all(parts)
    closed = union.buffer(0.5 * NARROW_M, quad_segs=_SEGMENTS).buffer(-0.5 * NARROW_M, quad_segs=_SEGMENTS)
    return closed.simplify(0.05)


def _links(root: ET.Element) -> dict[tuple[str, int], ET.Element]:
    """Return (junction, row in its right-of-way matrix) → connection."""
    leaving = leaving_lanes(root.iterfind("connection"))
    links = {}
    for junction in root.iterfind("junction"):
        if junction.get("type") != "internal":
            rows = [c for lane in junction.get("incLanes", "").split() for c in leaving[lane]]
            links.update({(junction.get("id", ""), number): c for number, c in enumerate(rows)})
    return links


def _strip(lane: ET.Element, junction: str = "", request: int = -1, is_straight: bool = False) -> Strip:
    width_m, speed_mps = float(lane.get("width", DEFAULT_LANE_WIDTH_M)), float(lane.get("speed", 13.9))
    line = LineString(shape_of(lane))
    return Strip(lane.get("id", ""), line, width_m, speed_mps, junction, request, is_straight)


def _is_for_vehicles(lane: ET.Element) -> bool:
    if len(shape_of(lane)) < 2:
        return False
    return not permissions(lane.get("allow"), lane.get("disallow")) <= _NOT_ON_WHEELS
