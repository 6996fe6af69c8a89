"""Write a net plan as OpenDRIVE 1.7 with exact centre lines.

netconvert's own export draws the lanes of an edge as a bundle beside one reference line, which moves uneven lanes by
metres; here every lane and every way through a junction is a road of its own with its centre line as reference line.
A width that varies along a lane is written as it varies.
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
FIRST_ROAD, FIRST_WAY = 10_000, 500_000  # ids; a city has some thousand lanes
TOUCH_M = 1e-6
_SAME_SLOPE = 1e-6
STEEPEST = 0.5  # change of a lane's width per metre; readers draw steeper borders in bends decimetres off
LaneKey = tuple[str, int]


@dataclass(frozen=True)
class _Road:
    """What is written of one lane or way; *widths* are (arc length, width) in m, linear between them."""

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

    Roads of edge lanes are named as SUMO names its lanes ("e3_0"), those of ways "e3_0->e4_1". Lane -1 is centred
    on the reference line by a lane offset. Lanes that share an edge carry its name in ``userData``. Every road leads
    one way, along its reference line: that is rule "RHT" on either side of the world, and netconvert knows no other;
    where traffic keeps left, ``userData`` of the header says so. Ways take over yaw and width of the lanes that they
    join, so that borders meet.
    """
    root = ET.Element("OpenDRIVE")
    _header(root, plan, location, projection)
    junction = {place.id: str(index + 1) for index, place in enumerate(plan.junctions)}
    keys = [(edge.id, index) for edge in plan.edges for index in range(len(edge.lanes))]
    road_of = {key: str(FIRST_ROAD + number) for number, key in enumerate(keys)}
    _lanes(root, plan, road_of, junction)
    _ways(root, plan, road_of, junction)
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _header(root: ET.Element, plan: NetPlan, location: str, projection: str | None) -> None:
    xy = np.vstack([lane.shape_m for edge in plan.edges for lane in edge.lanes])
    low, high = xy.min(axis=0), xy.max(axis=0)
    bounds = {"west": low[0], "south": low[1], "east": high[0], "north": high[1]}
    header = ET.SubElement(root, "header", revMajor="1", revMinor="7", name=location, version="1.00")
    for side, value in bounds.items():
        header.set(side, f"{value:.4f}")
    if projection:
        ET.SubElement(header, "geoReference").text = projection
    if plan.lefthand:
        ET.SubElement(header, "userData", code="traffic", value="left")


def _lanes(root: ET.Element, plan: NetPlan, road_of: dict[LaneKey, str], junction: dict[str, str]) -> None:
    """Add the roads of edge lanes."""
    left, entered = {way.origin for way in plan.connections}, {way.target for way in plan.connections}
    for edge in plan.edges:
        for index, lane in enumerate(edge.lanes):
            line = smooth(lane.shape_m, start_yaw(lane.shape_m), end_yaw(lane.shape_m))
            number, name = road_of[edge.id, index], f"{edge.id}_{index}"
            widths = _widths(lane, sum(stretch.length_m for stretch in line))
            road = _Road(number, name, "-1", line, widths, lane.speed_mps, LANE_TYPE[lane.use])
            links = {}  # a reader may invent ways for a lane that touches a junction without any
            if (edge.id, index) in entered:
                links["predecessor"] = {"elementType": "junction", "elementId": junction[edge.origin]}
            if (edge.id, index) in left:
                links["successor"] = {"elementType": "junction", "elementId": junction[edge.target]}
            ET.SubElement(_add(root, road, links), "userData", code="edge", value=edge.id)


def _widths(lane: LanePlan, length_m: float = 1.0) -> tuple[tuple[float, float], ...]:
    """Return the widths along a road of *length_m* for *lane*; smoothing the line has changed its length a little.

    Where a lane flares at its mouth faster than ``STEEPEST``, it keeps that slope from its narrower side.
    """
    if not len(lane.widths):
        return ((0.0, lane.width_m),)
    s, measured = lane.widths.T
    width = np.min(measured + STEEPEST * np.abs(s[:, None] - s), axis=1)
    return tuple(zip((s * (length_m / s[-1])).tolist(), width.tolist(), strict=True))


def _ways(root: ET.Element, plan: NetPlan, road_of: dict[LaneKey, str], junction: dict[str, str]) -> None:
    """Add connecting roads and the junctions that hold them."""
    edges = {edge.id: edge for edge in plan.edges}
    held: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for index, way in enumerate(plan.connections):
        place, number = edges[way.origin[0]].target, str(FIRST_WAY + index)
        origin, target = edges[way.origin[0]].lanes[way.origin[1]], edges[way.target[0]].lanes[way.target[1]]
        road = _way(way, origin, target, number, junction[place])
        before = {"elementType": "road", "elementId": road_of[way.origin], "contactPoint": "end"}
        after = {"elementType": "road", "elementId": road_of[way.target], "contactPoint": "start"}
        _add(root, road, {"predecessor": before, "successor": after})
        held[place].append((road_of[way.origin], number))
    for place, ways in held.items():
        element = ET.SubElement(root, "junction", id=junction[place], name=place)
        for index, (origin_id, road_id) in enumerate(ways):
            row = ET.SubElement(element, "connection", id=str(index), incomingRoad=origin_id)
            row.set("connectingRoad", road_id)
            row.set("contactPoint", "start")
            ET.SubElement(row, "laneLink", {"from": "-1", "to": "-1"})


def _way(way: ConnectionPlan, origin: LanePlan, target: LanePlan, number: str, junction: str) -> _Road:
    """Return the connecting road, drawn from the end of one lane to the beginning of the other."""
    line = _touching(_touching(way.shape_m, origin.shape_m[-1])[::-1], target.shape_m[0])[::-1]
    stretches = smooth(line, end_yaw(origin.shape_m), start_yaw(target.shape_m))
    length = sum(stretch.length_m for stretch in stretches)
    first, last = _widths(origin)[-1][1], _widths(target)[0][1]
    widths = ((0.0, first), (length, last)) if first != last else ((0.0, first),)
    name = f"{way.origin[0]}_{way.origin[1]}->{way.target[0]}_{way.target[1]}"
    return _Road(number, name, junction, stretches, widths, way.speed_mps, LANE_TYPE[origin.use])


def _touching(line: FloatArray, start: FloatArray) -> FloatArray:
    """Return *line* led on from *start* where it begins elsewhere."""
    return line if float(np.hypot(*(line[0] - start))) < TOUCH_M else np.vstack((start, line))


def _add(root: ET.Element, road: _Road, links: dict[str, dict[str, str]]) -> ET.Element:
    """Add a road with its reference line, lane offset and one lane."""
    element = ET.SubElement(root, "road", id=road.id, name=road.name, junction=road.junction, rule="RHT")
    element.set("length", _text(road.length_m))
    holder = ET.SubElement(element, "link")
    for side, link_names in links.items():
        ET.SubElement(holder, side, link_names)
    if np.isfinite(road.speed_mps):
        of_road = ET.SubElement(element, "type", s="0", type="town")
        ET.SubElement(of_road, "speed", max=f"{road.speed_mps:.2f}", unit="m/s")
    _plan_view(element, road.line)
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


def _plan_view(road: ET.Element, line: list[Stretch]) -> None:
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
    """Return (arc length, width, slope) where a width begins to change or stops changing."""
    ramps = [
        (s, width, (after - width) / (end - s)) for (s, width), (end, after) in itertools.pairwise(widths)
    ]
    kept = ramps[:1]
    for ramp in ramps[1:]:
        if (
            abs(ramp[2] - kept[-1][2]) > _SAME_SLOPE
        ):  # else the record before goes on; a second one is redundant
            kept.append(ramp)
    return kept or [(0.0, widths[0][1], 0.0)]


def _text(value: float) -> str:
    return f"{value:.9g}" if abs(value) < 1.0 else f"{value:.8f}"
