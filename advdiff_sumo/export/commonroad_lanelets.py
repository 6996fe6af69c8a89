"""Lanelets and speed limits of a scenario in the format of CommonRoad."""

from __future__ import annotations

from collections import defaultdict
from xml.etree import ElementTree as ET

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.export.export_scene import ExportScene, number
from advdiff_sumo.export.lane_use import LaneKind, kind_of
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
_SPEED_LIMIT = "274"  # the sign's number in Germany, which CommonRoad's imaginary country shares


def add_map(root: ET.Element, scene: ExportScene) -> int:
    """Add a lanelet for every lane of *scene*, numbered from 1, then signs; return the next free number."""
    lanes = {lane.id: lane for lane in scene.lanes if kind_of(lane) in _TYPES}
    numbers = {name: number_ for number_, name in enumerate(lanes, start=1)}
    before: dict[str, list[str]] = defaultdict(list)
    after: dict[str, list[str]] = defaultdict(list)
    for one, other in scene.joints(numbers):
        after[one].append(other)
        before[other].append(one)
    limits = sorted({round(lane.speed_mps, 4) for lane in lanes.values()})
    signs = {limit: len(numbers) + 1 + index for index, limit in enumerate(limits)}
    first: dict[float, Lane] = {}
    for name, lane in lanes.items():
        limit = round(lane.speed_mps, 4)
        first.setdefault(limit, lane)
        element = ET.SubElement(root, "lanelet", id=str(numbers[name]))
        _bounds(element, lane)
        for tag, names in (("predecessor", before[name]), ("successor", after[name])):
            for other in names:
                ET.SubElement(element, tag, ref=str(numbers[other]))
        _neighbours(element, lane, numbers)
        kind = kind_of(lane)
        ET.SubElement(element, "laneletType").text = _TYPES[kind]
        if lane.is_internal:
            ET.SubElement(element, "laneletType").text = "intersection"
        ET.SubElement(element, "userOneWay").text = _USERS[kind]
        ET.SubElement(element, "trafficSignRef", ref=str(signs[limit]))
    for limit, sign in signs.items():
        _sign(root, sign, limit, first[limit].centre_xy_m[0])
    return len(numbers) + len(signs) + 1


def _bounds(element: ET.Element, lane: Lane) -> None:
    """Add both bounds, which must have as many points as each other."""
    sides = [lane.line.offset(d_m) for d_m in (0.5 * lane.width_m, -0.5 * lane.width_m)]
    if len(sides[0].xy_m) != len(sides[1].xy_m):
        most = max(len(side.xy_m) for side in sides)
        sides = [side.resample(count=most) for side in sides]
    for tag, side in zip(("leftBound", "rightBound"), sides, strict=True):
        bound = ET.SubElement(element, tag)
        for x, y in side.xy_m:
            point = ET.SubElement(bound, "point")
            ET.SubElement(point, "x").text = number(x)
            ET.SubElement(point, "y").text = number(y)


def _neighbours(element: ET.Element, lane: Lane, numbers: dict[str, int]) -> None:
    for tag, name in (("adjacentLeft", lane.left_id), ("adjacentRight", lane.right_id)):
        if name in numbers:
            ET.SubElement(element, tag, ref=str(numbers[name]), drivingDir="same")


def _sign(root: ET.Element, number_: int, limit_mps: float, xy_m: FloatArray) -> None:
    sign = ET.SubElement(root, "trafficSign", id=str(number_))
    kind = ET.SubElement(sign, "trafficSignElement")
    ET.SubElement(kind, "trafficSignID").text = _SPEED_LIMIT
    ET.SubElement(kind, "additionalValue").text = number(limit_mps)
    point = ET.SubElement(ET.SubElement(sign, "position"), "point")
    for name, value in zip(("x", "y"), xy_m, strict=True):
        ET.SubElement(point, name).text = number(value)
    ET.SubElement(sign, "virtual").text = "true"
