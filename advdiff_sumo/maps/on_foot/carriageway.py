"""What vehicles use of a net, as geometry: lanes, ways through junctions, and the carriageway that they make up."""

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
"""Classes of SUMO that do not drive on a carriageway; its footways are open to several of them."""
NARROW_M = 1.2  # a gap between lanes narrower than this is no island to stand on


@dataclass(frozen=True, eq=False)
class Strip:
    """A lane of an edge, or a way through a junction.

    Attributes:
        lane: SUMO's name of the lane.
        line: centre line.
        width_m: width.
        speed_mps: speed limit.
        junction: the junction that a way lies in; "" for a lane of an edge.
        link: number of the way's right-of-way row in its junction; -1 for a lane.
        straight: whether the way goes straight on.
    """

    lane: str
    line: LineString
    width_m: float
    speed_mps: float
    junction: str = ""
    link: int = -1
    straight: bool = False


class Carriageway:
    """The lanes and ways of a net for vehicles; edges beyond the rim and those on foot or on rails are left out.

    Attributes:
        root: the net.
        strips: lanes and ways.
        links: connection of each way, by junction and number of its right-of-way row.
    """

    def __init__(self, root: ET.Element, drivable: BaseGeometry | None = None) -> None:
        """Read the net *root*; *drivable* is carriageway where it is near a lane."""
        self.root = root
        self._beyond = ids_beyond(root)
        self.links = _links(root)
        self.strips = (*self._lanes(), *self._ways())
        self._drivable = drivable
        self._tree = shapely.STRtree([strip.line for strip in self.strips])

    def crossed_by(self, shape: BaseGeometry) -> list[Strip]:
        """Return the strips whose centre line meets *shape*."""
        numbers = self._tree.query(shape, predicate="intersects").tolist()
        return [self.strips[number] for number in sorted(numbers)]

    @cached_property
    def area(self) -> BaseGeometry:
        """What vehicles may be on: lanes, ways and the drivable area."""
        return self.lanes_area if self._drivable is None else _closed([self.lanes_area, self._drivable])

    @cached_property
    def lanes_area(self) -> BaseGeometry:
        """Lanes and ways as wide as they are, gaps narrower than an island closed."""
        return _closed(
            [s.line.buffer(0.5 * s.width_m, cap_style="flat", join_style="mitre") for s in self.strips]
        )

    @cached_property
    def open_ends(self) -> tuple[tuple[Point, float], ...]:
        """Ends of lanes at which the net ends, each with the lane's width in m."""
        rows = [
            c for c in self.root.iterfind("connection") if not {c.get("from"), c.get("to")} & self._beyond
        ]
        left = {(c.get("from"), c.get("fromLane")) for c in rows}
        entered = {(c.get("to"), c.get("toLane")) for c in rows}
        ends = []
        for strip in self.strips:
            key = tuple(strip.lane.rsplit("_", 1))
            if not strip.junction and key not in left:
                ends.append((Point(strip.line.coords[-1]), strip.width_m))
            if not strip.junction and key not in entered:
                ends.append((Point(strip.line.coords[0]), strip.width_m))
        return tuple(ends)

    def _lanes(self) -> list[Strip]:
        rows = (
            lane
            for edge in self.root.iterfind("edge")
            if edge.get("function", "normal") == "normal" and edge.get("id") not in self._beyond
            for lane in edge.iterfind("lane")
        )
        return [_strip(lane) for lane in rows if _for_vehicles(lane)]

    def _ways(self) -> list[Strip]:
        owner = {
            via: (junction, number, connection.get("dir") == "s")
            for (junction, number), connection in self.links.items()
            for via in self.parts(connection)
        }
        lanes = (
            lane
            for edge in self.root.iterfind("edge")
            if edge.get("function") == "internal" and edge.get("id") not in self._beyond
            for lane in edge.iterfind("lane")
        )
        return [
            _strip(lane, *owner[lane.get("id", "")])
            for lane in lanes
            if lane.get("id") in owner and _for_vehicles(lane)
        ]

    @cached_property
    def _onward(self) -> dict[str, str]:
        """Return the second internal lane of ways that a waiting place divides, by the first."""
        rows = (
            c for c in self.root.iterfind("connection") if c.get("from", "").startswith(":") and c.get("via")
        )
        return {f"{c.get('from')}_{c.get('fromLane')}": c.get("via", "") for c in rows}

    def parts(self, connection: ET.Element) -> list[str]:
        """Return the internal lanes of a way, in the order in which one drives them."""
        via = connection.get("via", "")
        vias = [via]
        while via in self._onward:
            via = self._onward[via]
            vias.append(via)
        return vias


def _closed(parts: Sequence[BaseGeometry]) -> BaseGeometry:
    whole = shapely.union_all(parts)
    closed = whole.buffer(0.5 * NARROW_M, quad_segs=4).buffer(-0.5 * NARROW_M, quad_segs=4)
    return closed.simplify(0.05)


def _links(root: ET.Element) -> dict[tuple[str, int], ET.Element]:
    """Return the connections of each junction by the number of their right-of-way row."""
    leaving = leaving_lanes(root.iterfind("connection"))
    links = {}
    for junction in root.iterfind("junction"):
        if junction.get("type") != "internal":
            rows = [row for lane in junction.get("incLanes", "").split() for row in leaving[lane]]
            links.update({(junction.get("id", ""), number): row for number, row in enumerate(rows)})
    return links


def _strip(lane: ET.Element, junction: str = "", link: int = -1, straight: bool = False) -> Strip:
    width_m = float(lane.get("width", DEFAULT_LANE_WIDTH_M))
    line = LineString(shape_of(lane))
    return Strip(lane.get("id", ""), line, width_m, float(lane.get("speed", 13.9)), junction, link, straight)


def _for_vehicles(lane: ET.Element) -> bool:
    if len(shape_of(lane)) < 2:
        return False
    return not permissions(lane.get("allow"), lane.get("disallow")) <= _NOT_ON_WHEELS
