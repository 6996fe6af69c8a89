"""Writes the lanelets and speed limits of a scenario in CommonRoad's format."""

from __future__ import annotations

from collections import defaultdict
from xml.etree import ElementTree as ET

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.export.export_scene import ExportScene, decimal_text
from advdiff_sumo.export.lane_use import LaneKind, lane_kind
from advdiff_sumo.maps import Lane

_TYPES = {
    LaneKind.CAR: "urban",
    LaneKind.BUS: "busLane",
    LaneKind.BICYCLE: "bicycleLane",
    LaneKind.FOOT: "sidewalk",
}
_USERS = {
    LaneKind.CAR: "vehicle",
    LaneKind.BUS: "bus",
    LaneKind.BICYCLE: "bicycle",
    LaneKind.FOOT: "pedestrian",
}
_SPEED_LIMIT = "274"  # number of the German sign, which CommonRoad's imaginary country uses too


def add_map(root: ET.Element, scene: ExportScene) -> int:
    """Add a lanelet for every lane of *scene*, then a sign for every speed limit; return the next free id."""
    lanes = {lane.id: lane for lane in scene.lanes if lane_kind(lane) in _TYPES}
    lanelet_ids = {name: number for number, name in enumerate(lanes, start=1)}
    predecessors: dict[str, list[str]] = defaultdict(list)
    successors: dict[str, list[str]] = defaultdict(list)
    for name, successor in scene.joints(lanelet_ids):
        successors[name].append(successor)
        predecessors[successor].append(name)
    limits = sorted({round(lane.speed_mps, 4) for lane in lanes.values()})
    sign_ids = {limit: len(lanelet_ids) + 1 + index for index, limit in enumerate(limits)}
    first_lanes: dict[float, Lane] = {}
    for name, lane in lanes.items():
        limit = round(lane.speed_mps, 4)
        first_lanes.setdefault(limit, lane)
        element = ET.SubElement(root, "lanelet", id=str(lanelet_ids[name]))
        _add_bounds(element, lane)
        for tag, names in (("predecessor", predecessors[name]), ("successor", successors[name])):
            for other in names:
                ET.SubElement(element, tag, ref=str(lanelet_ids[other]))
        _add_neighbours(element, lane, lanelet_ids)
        kind = lane_kind(lane)
        ET.SubElement(element, "laneletType").text = _TYPES[kind]
        if lane.is_internal:
            ET.SubElement(element, "laneletType").text = "intersection"
        ET.SubElement(element, "userOneWay").text = _USERS[kind]
        ET.SubElement(element, "trafficSignRef", ref=str(sign_ids[limit]))
    for limit, sign_id in sign_ids.items():
        _add_sign(root, sign_id, limit, first_lanes[limit].centre_xy_m[0])
    return len(lanelet_ids) + len(sign_ids) + 1


def _add_bounds(element: ET.Element, lane: Lane) -> None:
    """Add the left and right bounds, which must have the same number of points."""
    sides = [lane.line.offset(d_m) for d_m in (0.5 * lane.width_m, -0.5 * lane.width_m)]
    if len(sides[0].xy_m) != len(sides[1].xy_m):
        count = max(len(side.xy_m) for side in sides)
        sides = [side.resample(count=count) for side in sides]
    for tag, side in zip(("leftBound", "rightBound"), sides, strict=True):
        bound = ET.SubElement(element, tag)
        for x, y in side.xy_m:
            point = ET.SubElement(bound, "point")
            ET.SubElement(point, "x").text = decimal_text(x)
            ET.SubElement(point, "y").text = decimal_text(y)


def _add_neighbours(element: ET.Element, lane: Lane, lanelet_ids: dict[str, int]) -> None:
    for tag, name in (("adjacentLeft", lane.left_id), ("adjacentRight", lane.right_id)):
        if name in lanelet_ids:
            ET.SubElement(element, tag, ref=str(lanelet_ids[name]), drivingDir="same")


def _add_sign(root: ET.Element, sign_id: int, limit_mps: float, xy_m: FloatArray) -> None:
    sign = ET.SubElement(root, "trafficSign", id=str(sign_id))
    kind = ET.SubElement(sign, "trafficSignElement")
    ET.SubElement(kind, "trafficSignID").text = _SPEED_LIMIT
    ET.SubElement(kind, "additionalValue").text = decimal_text(limit_mps)
    point = ET.SubElement(ET.SubElement(sign, "position"), "point")
    for name, value in zip(("x", "y"), xy_m, strict=True):
        ET.SubElement(point, name).text = decimal_text(value)
    ET.SubElement(sign, "virtual").text = "true"
