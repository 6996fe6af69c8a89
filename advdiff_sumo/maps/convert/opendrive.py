"""Write a net plan as OpenDRIVE 1.6 with exact centre lines.

netconvert's own export draws the lanes of an edge as a bundle beside one reference line, which moves uneven lanes by
metres; here every lane and every way through a junction is a road of its own with its centre line as reference line.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.netplan import NetPlan
from advdiff_sumo.maps.convert.source import LaneUse

LANE_TYPE = {LaneUse.CAR: "driving", LaneUse.BUS: "bus", LaneUse.BICYCLE: "biking"}


def write_opendrive(plan: NetPlan, path: Path, location: str, projection: str | None) -> None:
    """Write *plan* to *path*.

    Roads of edge lanes are named as SUMO names its lanes ("e3_0"), those of ways "e3_0->e4_1". Lane -1 is centred
    on the reference line by a lane offset. Lanes that share an edge carry its name in ``userData``.
    """
    root = ET.Element("OpenDRIVE")
    _header(root, plan, location, projection)
    number = {edge.id: index for index, edge in enumerate(plan.junctions)}
    junction = {j.id: str(number[j.id] + 1) for j in plan.junctions}
    joined = {edge.target for edge in plan.edges} & {edge.origin for edge in plan.edges}
    road_of: dict[tuple[str, int], str] = {}
    for edge in plan.edges:
        for index, lane in enumerate(edge.lanes):
            road_of[edge.id, index] = str(10_000 + len(road_of))
            road = _road(root, road_of[edge.id, index], f"{edge.id}_{index}", "-1", lane.shape_m)
            link = ET.SubElement(road, "link")
            for name, place in (("predecessor", edge.origin), ("successor", edge.target)):
                if place in joined:
                    ET.SubElement(link, name, elementType="junction", elementId=junction[place])
            _body(road, lane.shape_m, lane.width_m, lane.speed_mps, LANE_TYPE[lane.use])
            ET.SubElement(road, "userData", code="edge", value=edge.id)
    _ways(root, plan, road_of, junction)
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _header(root: ET.Element, plan: NetPlan, location: str, projection: str | None) -> None:
    xy = np.vstack([lane.shape_m for edge in plan.edges for lane in edge.lanes])
    low, high = xy.min(axis=0), xy.max(axis=0)
    bounds = {"west": low[0], "south": low[1], "east": high[0], "north": high[1]}
    header = ET.SubElement(root, "header", revMajor="1", revMinor="6", name=location, version="1.00")
    for side, value in bounds.items():
        header.set(side, f"{value:.4f}")
    if projection:
        ET.SubElement(header, "geoReference").text = projection


def _road(root: ET.Element, number: str, name: str, junction: str, line: FloatArray) -> ET.Element:
    return ET.SubElement(
        root, "road", id=number, name=name, junction=junction, length=_text(polyline.length(line)), rule="RHT"
    )


def _body(road: ET.Element, line: FloatArray, width_m: float, speed_mps: float, kind: str) -> None:
    """Add reference line, lane offset and the one lane of a road."""
    if np.isfinite(speed_mps):
        of_road = ET.SubElement(road, "type", s="0", type="town")
        ET.SubElement(of_road, "speed", max=f"{speed_mps:.2f}", unit="m/s")
    view = ET.SubElement(road, "planView")
    s = polyline.stations(line)
    for index, step in enumerate(np.diff(line, axis=0)):
        values = {
            "s": s[index],
            "x": line[index, 0],
            "y": line[index, 1],
            "hdg": np.arctan2(step[1], step[0]),
        }
        piece = ET.SubElement(view, "geometry", {name: _text(float(value)) for name, value in values.items()})
        piece.set("length", _text(float(s[index + 1] - s[index])))
        ET.SubElement(piece, "line")
    lanes = ET.SubElement(road, "lanes")
    ET.SubElement(lanes, "laneOffset", s="0", a=_text(0.5 * width_m), b="0", c="0", d="0")
    section = ET.SubElement(lanes, "laneSection", s="0")
    centre = ET.SubElement(section, "center")
    ET.SubElement(centre, "lane", id="0", type="none", level="false")
    lane = ET.SubElement(ET.SubElement(section, "right"), "lane", id="-1", type=kind, level="false")
    link = ET.SubElement(lane, "link")
    if road.get("junction") != "-1":
        ET.SubElement(link, "predecessor", id="-1")
        ET.SubElement(link, "successor", id="-1")
    ET.SubElement(lane, "width", sOffset="0", a=_text(width_m), b="0", c="0", d="0")


def _ways(
    root: ET.Element, plan: NetPlan, road_of: dict[tuple[str, int], str], junction: dict[str, str]
) -> None:
    """Add connecting roads and the junctions that hold them."""
    edges = {edge.id: edge for edge in plan.edges}
    held: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for index, way in enumerate(plan.connections):
        origin, target = road_of[way.origin], road_of[way.target]
        place = edges[way.origin[0]].target
        first, last = f"{way.origin[0]}_{way.origin[1]}", f"{way.target[0]}_{way.target[1]}"
        road = _road(root, str(50_000 + index), f"{first}->{last}", junction[place], way.shape_m)
        link = ET.SubElement(road, "link")
        ET.SubElement(link, "predecessor", elementType="road", elementId=origin, contactPoint="end")
        ET.SubElement(link, "successor", elementType="road", elementId=target, contactPoint="start")
        lane = edges[way.origin[0]].lanes[way.origin[1]]
        _body(road, way.shape_m, lane.width_m, way.speed_mps, LANE_TYPE[lane.use])
        held[place].append((origin, str(50_000 + index)))
    for place, ways in held.items():
        element = ET.SubElement(root, "junction", id=junction[place], name=place)
        for index, (origin, road_id) in enumerate(ways):
            row = ET.SubElement(
                element,
                "connection",
                id=str(index),
                incomingRoad=origin,
                connectingRoad=road_id,
                contactPoint="start",
            )
            ET.SubElement(row, "laneLink", {"from": "-1", "to": "-1"})


def _text(value: float) -> str:
    return f"{value:.9g}" if abs(value) < 1.0 else f"{value:.6f}"
