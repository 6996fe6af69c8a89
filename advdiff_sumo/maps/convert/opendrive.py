"""Write a net plan as OpenDRIVE 1.7 with exact centre lines.

netconvert's own export draws all lanes of an edge at constant offsets from one reference line, which moves uneven lanes
by metres. Here every lane and every connection is a road of its own with its centre line as reference line. A width
that varies along a lane is written as it varies.
Format: ASAM OpenDRIVE 1.7.0, https://www.asam.net/standards/detail/opendrive.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.netplan import ConnectionPlan, LanePlan, NetPlan
from advdiff_sumo.maps.convert.reference_line import Stretch, end_yaw, smooth, start_yaw
from advdiff_sumo.maps.convert.sources.source_map import LaneUse

LANE_TYPE = {LaneUse.CAR: "driving", LaneUse.BUS: "bus", LaneUse.BICYCLE: "biking"}
FIRST_ROAD = 10_000  # id of the first road of an edge lane
FIRST_CONNECTING_ROAD = 500_000  # id of the first connecting road; a city has some thousand lanes
TOUCH_M = 1e-6  # lines whose ends are closer meet
SAME_SLOPE = 1e-6  # changes of width per metre that differ by no more are equal
# Largest change of a lane's width per metre: readers draw steeper borders in bends some decimetres off.
STEEPEST = 0.5
LaneKey = tuple[str, int]  # edge and lane index


@dataclass(frozen=True)
class _Road:
    """The road of one lane or connection; *widths* are (arc length, width) in m, linear between them."""

    id: str
    name: str
    junction: str
    line: list[Stretch]
    widths: tuple[tuple[float, float], ...]
    speed_mps: float
    kind: str

    @property
    def length_m(self) -> float:
        return sum(stretch.length_m for stretch in self.line)


def write_opendrive(plan: NetPlan, path: Path, location: str, projection: str | None) -> None:
    """Write *plan* to *path*.

    Roads of edge lanes are named as SUMO names its lanes ("e3_0"), those of connections "e3_0->e4_1". A lane offset
    centres lane -1 on the reference line. Lanes that share an edge carry the edge's name in ``userData``. Every road is
    one-way along its reference line, so its rule is "RHT", the only one that netconvert knows, even if traffic keeps
    left; then ``userData`` of the header says so. Connecting roads have the headings and widths of the lanes that they
    join, so that borders meet.

    Args:
        plan: the planned net.
        path: file to write.
        location: name of the place.
        projection: PROJ string of the net's frame, if known.
    """
    root = ET.Element("OpenDRIVE")
    _add_header(root, plan, location, projection)
    junction = {node.id: str(index + 1) for index, node in enumerate(plan.junctions)}
    keys = [(edge.id, index) for edge in plan.edges for index in range(len(edge.lanes))]
    road_of = {key: str(FIRST_ROAD + number) for number, key in enumerate(keys)}
    _add_lane_roads(root, plan, road_of, junction)
    _add_connecting_roads(root, plan, road_of, junction)
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _add_header(root: ET.Element, plan: NetPlan, location: str, projection: str | None) -> None:
    low, high = plan.lane_points_m.min(axis=0), plan.lane_points_m.max(axis=0)
    bounds = {"west": low[0], "south": low[1], "east": high[0], "north": high[1]}
    header = ET.SubElement(root, "header", revMajor="1", revMinor="7", name=location, version="1.00")
    for side, value in bounds.items():
        header.set(side, f"{value:.4f}")
    if projection:
        ET.SubElement(header, "geoReference").text = projection
    if plan.lefthand:
        ET.SubElement(header, "userData", code="traffic", value="left")


def _add_lane_roads(
    root: ET.Element, plan: NetPlan, road_of: dict[LaneKey, str], junction: dict[str, str]
) -> None:
    """Add the roads of edge lanes."""
    lanes_with_successor = {connection.origin for connection in plan.connections}
    lanes_with_predecessor = {connection.target for connection in plan.connections}
    for edge in plan.edges:
        for index, lane in enumerate(edge.lanes):
            line = smooth(lane.shape_m, start_yaw(lane.shape_m), end_yaw(lane.shape_m))
            number, name = road_of[edge.id, index], f"{edge.id}_{index}"
            widths = _widths(lane, sum(stretch.length_m for stretch in line))
            road = _Road(number, name, "-1", line, widths, lane.speed_mps, LANE_TYPE[lane.use])
            links = {}  # no link without a connection: a reader may invent one for a lane that touches a junction
            if (edge.id, index) in lanes_with_predecessor:
                links["predecessor"] = {"elementType": "junction", "elementId": junction[edge.origin]}
            if (edge.id, index) in lanes_with_successor:
                links["successor"] = {"elementType": "junction", "elementId": junction[edge.target]}
            ET.SubElement(_add_road(root, road, links), "userData", code="edge", value=edge.id)


def _widths(lane: LanePlan, length_m: float = 1.0) -> tuple[tuple[float, float], ...]:
    """Return the (arc length, width) pairs of *lane* along a road of *length_m*.

    Arc lengths are scaled, as smoothing the line changed its length a little. Where the width changes faster than
    ``STEEPEST``, it changes at that rate, starting from the narrower side.
    """
    if not len(lane.widths):
        return ((0.0, lane.width_m),)
    s, measured = lane.widths.T
    width = np.min(measured + STEEPEST * np.abs(s[:, None] - s), axis=1)
    return tuple(zip((s * (length_m / s[-1])).tolist(), width.tolist(), strict=True))


def _add_connecting_roads(
    root: ET.Element, plan: NetPlan, road_of: dict[LaneKey, str], junction: dict[str, str]
) -> None:
    """Add connecting roads and the junctions that contain them."""
    roads_of_junction: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for index, connection in enumerate(plan.connections):
        (origin_edge, origin_lane), (target_edge, target_lane) = connection.origin, connection.target
        name, number = plan.edge_of[origin_edge].target, str(FIRST_CONNECTING_ROAD + index)
        origin = plan.edge_of[origin_edge].lanes[origin_lane]
        target = plan.edge_of[target_edge].lanes[target_lane]
        road = _connecting_road(connection, origin, target, number, junction[name])
        before = {"elementType": "road", "elementId": road_of[connection.origin], "contactPoint": "end"}
        after = {"elementType": "road", "elementId": road_of[connection.target], "contactPoint": "start"}
        _add_road(root, road, {"predecessor": before, "successor": after})
        roads_of_junction[name].append((road_of[connection.origin], number))
    for name, road_pairs in roads_of_junction.items():
        element = ET.SubElement(root, "junction", id=junction[name], name=name)
        for index, (origin_id, road_id) in enumerate(road_pairs):
            row = ET.SubElement(element, "connection", id=str(index), incomingRoad=origin_id)
            row.set("connectingRoad", road_id)
            row.set("contactPoint", "start")
            ET.SubElement(row, "laneLink", {"from": "-1", "to": "-1"})


def _connecting_road(
    connection: ConnectionPlan, origin: LanePlan, target: LanePlan, number: str, junction: str
) -> _Road:
    """Return the connecting road, drawn from the end of lane *origin* to the beginning of lane *target*."""
    line = _touching(_touching(connection.shape_m, origin.shape_m[-1])[::-1], target.shape_m[0])[::-1]
    stretches = smooth(line, end_yaw(origin.shape_m), start_yaw(target.shape_m))
    length = sum(stretch.length_m for stretch in stretches)
    first, last = _widths(origin)[-1][1], _widths(target)[0][1]
    widths = ((0.0, first), (length, last)) if first != last else ((0.0, first),)
    (origin_edge, origin_lane), (target_edge, target_lane) = connection.origin, connection.target
    name = f"{origin_edge}_{origin_lane}->{target_edge}_{target_lane}"
    return _Road(number, name, junction, stretches, widths, connection.speed_mps, LANE_TYPE[origin.use])


def _touching(line: FloatArray, start: FloatArray) -> FloatArray:
    """Return *line* extended to begin at *start*, if it begins elsewhere."""
    return line if float(np.hypot(*(line[0] - start))) < TOUCH_M else np.vstack((start, line))


def _add_road(root: ET.Element, road: _Road, links: dict[str, dict[str, str]]) -> ET.Element:
    """Add a road with its reference line, lane offset and one lane, and return it."""
    element = ET.SubElement(root, "road", id=road.id, name=road.name, junction=road.junction, rule="RHT")
    element.set("length", _text(road.length_m))
    road_link = ET.SubElement(element, "link")
    for side, attributes in links.items():
        ET.SubElement(road_link, side, attributes)
    if np.isfinite(road.speed_mps):
        road_type = ET.SubElement(element, "type", s="0", type="town")
        ET.SubElement(road_type, "speed", max=f"{road.speed_mps:.2f}", unit="m/s")
    _add_plan_view(element, road.line)
    lanes = ET.SubElement(element, "lanes")
    for s, width, slope in _ramps(road.widths):
        ET.SubElement(
            lanes, "laneOffset", s=_text(s), a=_text(0.5 * width), b=_text(0.5 * slope), c="0", d="0"
        )
    section = ET.SubElement(lanes, "laneSection", s="0")
    ET.SubElement(ET.SubElement(section, "center"), "lane", id="0", type="none", level="false")
    lane = ET.SubElement(ET.SubElement(section, "right"), "lane", id="-1", type=road.kind, level="false")
    link = ET.SubElement(lane, "link")
    if road.junction != "-1":
        ET.SubElement(link, "predecessor", id="-1")
        ET.SubElement(link, "successor", id="-1")
    for s, width, slope in _ramps(road.widths):
        ET.SubElement(lane, "width", sOffset=_text(s), a=_text(width), b=_text(slope), c="0", d="0")
    return element


def _add_plan_view(road: ET.Element, line: list[Stretch]) -> None:
    view, s = ET.SubElement(road, "planView"), 0.0
    for stretch in line:
        values = {"s": s, "x": stretch.x, "y": stretch.y, "hdg": stretch.yaw_rad, "length": stretch.length_m}
        piece = ET.SubElement(view, "geometry", {name: _text(value) for name, value in values.items()})
        if stretch.curvature:
            ET.SubElement(piece, "arc", curvature=_text(stretch.curvature))
        else:
            ET.SubElement(piece, "line")
        s += stretch.length_m


def _ramps(widths: tuple[tuple[float, float], ...]) -> list[tuple[float, float, float]]:
    """Return (arc length, width, change per metre) wherever the change of a width per metre itself changes."""
    ramps = [
        (s, width, (after - width) / (end - s)) for (s, width), (end, after) in itertools.pairwise(widths)
    ]
    kept = ramps[:1]
    for ramp in ramps[1:]:
        if abs(ramp[2] - kept[-1][2]) > SAME_SLOPE:  # otherwise the previous record continues
            kept.append(ramp)
    return kept or [(0.0, widths[0][1], 0.0)]


def _text(value: float) -> str:
    return f"{value:.9g}" if abs(value) < 1.0 else f"{value:.8f}"
