"""Read Lanelet2 maps (Poggenhans et al. 2018, DOI 10.1109/ITSC.2018.8569929): OSM XML with lanelet relations.

Positions are the nodes' ``local_x``, ``local_y`` in m if all nodes have them. Otherwise they are UTM coordinates in the
zone of the map's middle, relative to the map's south-west corner in full kilometres. Lanelets follow each other if they
share end nodes.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pyproj
from shapely.geometry import LineString, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert.projection import utm_from
from advdiff_sumo.maps.convert.sources.bounded_lanes import (
    LONGEST_M,
    BoundedLane,
    covered_area,
    lane_links,
    largest_part,
    on_earth,
    source_lanes,
)
from advdiff_sumo.maps.convert.sources.lanelet_centre import lanelet_centre
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.source_map import (
    LaneUse,
    Signal,
    SourceMap,
    StatedSizes,
    StopLine,
)
from advdiff_sumo.maps.not_a_net import EXTRACT, extract_command

REMEDY = "give an unchanged Lanelet2 map (.osm)"
USES = {"road": LaneUse.CAR, "highway": LaneUse.CAR, "play_street": LaneUse.CAR, "bus_lane": LaneUse.BUS}
USES |= {"bicycle_lane": LaneUse.BICYCLE, "emergency_lane": LaneUse.BUS, "": LaneUse.CAR}
ON_FOOT = {"crosswalk": "crossings", "walkway": "walkways", "shared_walkway": "walkways"}
UNITS_MPS = dict.fromkeys(("", "km/h", "kmh", "kph"), 1.0 / 3.6)
UNITS_MPS |= dict.fromkeys(("mph", "m/h"), 0.44704) | dict.fromkeys(("m/s", "mps"), 1.0)
SPEED = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(.*?)\s*", re.ASCII)
SAME_PLACE_M = 0.5  # tolerance between a node's position in degrees and in metres
LANE_CHANGE = ("lane_change", "lane_change:left", "lane_change:right")
STATED = {"yes": True, "true": True, "no": False, "false": False}
HALF_LINE_M = 0.25  # half the depth of a painted stop line
Tags = Mapping[str, str]


@dataclass(frozen=True)
class _Relation:
    id: str
    tags: Tags
    members: tuple[tuple[str, str], ...]  # (role, reference)

    def refs(self, role: str) -> list[str]:
        return [ref for name, ref in self.members if name == role]


def lanelet2_map(root: Element, path: Path) -> SourceMap:
    """Return the lanelets below *root*, read from *path*.

    Lanelets with a ``turn_direction`` are connectors. If no lanelet has one, connectors are found later by geometry.
    Lanelets for both directions are used only in the direction in which they are drawn.

    Raises:
        MapError: the file has another format, or no lanelet is usable.
    """
    relations = [_relation(row) for row in root.iterfind("relation")]
    lanelets = [row for row in relations if row.tags.get("type") == "lanelet"]
    if not lanelets and root.tag == "osm" and root.find("way/tag[@k='highway']") is not None:
        remedy = f"make a net of it: {extract_command(path)}; or give it with --osm beside an HD map"
        raise MapError(path, f"is {EXTRACT}, no Lanelet2 map", remedy)
    if root.tag != "osm" or not lanelets:
        raise MapError(path, "holds no relation of type lanelet, so it is no Lanelet2 map", REMEDY)
    faults = MapFaults(path)
    ways = _Ways(root, path)
    lanelets_for_vehicles = [row for row in lanelets if row.tags.get("subtype", "") in USES]
    bounded = [lane for row in lanelets_for_vehicles if (lane := _bounded_lane(row, ways, faults))]
    rows = _with_successors(_with_neighbours(bounded, lanelets_for_vehicles))
    lanes = source_lanes(rows, faults)
    if not lanes:
        raise MapError(path, "holds no usable lanelet for vehicles", REMEDY)
    known = {lane.token for lane in lanes}
    links, stated = lane_links(rows, lanes, faults)
    areas = _areas(lanelets, ways, faults)
    rules = [row for row in relations if row.tags.get("type") == "regulatory_element"]
    return SourceMap(
        path=path,
        location=path.name.removesuffix(".gz").removesuffix(".osm"),
        lanes=tuple(lanes),
        links=tuple(links),
        drivable=covered_area(lanes),
        crossings=tuple(areas["crossings"]),
        walkways=tuple(areas["walkways"]),
        stop_lines=tuple(_stop_lines(rules, ways)),
        signals=tuple(_signals(rules, lanelets, ways)),
        stated=StatedSizes(len(lanelets_for_vehicles), stated),
        left_out=tuple(row.id for row in lanelets_for_vehicles if row.id not in known),
        notes=faults.notes,
        warnings=faults.sentences(),
        projection=ways.projection,
    )


def _relation(row: Element) -> _Relation:
    members = tuple((m.get("role", ""), m.get("ref", "")) for m in row.iterfind("member"))
    return _Relation(row.get("id", ""), _tags(row), members)


def _tags(row: Element) -> Tags:
    return {tag.get("k", ""): tag.get("v", "") for tag in row.iterfind("tag")}


class _Ways:
    """Positions and tags of the ways of a map, and the projection of the positions if it is known."""

    def __init__(self, root: Element, path: Path) -> None:
        self._xy, self.projection = _node_positions(root, path)
        self._nodes = {
            row.get("id", ""): [nd.get("ref", "") for nd in row.iterfind("nd")]
            for row in root.iterfind("way")
        }
        self.tags = {row.get("id", ""): _tags(row) for row in root.iterfind("way")}

    def points(self, name: str) -> FloatArray:
        """Return the points (N, 2) of way *name* in m.

        Raises:
            ValueError: the way or one of its nodes does not exist.
        """
        if name not in self._nodes:
            raise ValueError(f"way {name!r} does not exist")
        missing = next((node for node in self._nodes[name] if node not in self._xy), None)
        if missing is not None:
            raise ValueError(f"node {missing!r} of way {name!r} does not exist")
        points = np.array([self._xy[node] for node in self._nodes[name]], dtype=np.float64).reshape(-1, 2)
        if np.isnan(on_earth(points)).any():
            raise ValueError(f"a coordinate of way {name!r} is no place on earth")
        return points


def _node_positions(root: Element, path: Path) -> tuple[dict[str, tuple[float, float]], str | None]:
    """Return the positions of nodes in the map's frame in m, and the projection of the frame if it is known."""
    rows = [(row.get("id", ""), row, _tags(row)) for row in root.iterfind("node")]
    try:
        if all("local_x" in tags and "local_y" in tags for *_, tags in rows):
            local = {name: (float(tags["local_x"]), float(tags["local_y"])) for name, _, tags in rows}
            return local, _projection(rows, np.array(list(local.values())))
        degrees = np.array([[float(row.attrib["lon"]), float(row.attrib["lat"])] for _, row, _ in rows])
    except (KeyError, ValueError) as error:
        raise MapError(path, f"a node has no place ({error})", REMEDY) from None
    if not (np.abs(degrees) <= (180.0, 84.0)).all():
        raise MapError(path, "a node lies at no place on earth where UTM holds", REMEDY)
    zone, south, xy = _in_utm(degrees)
    corner = np.floor(xy.min(axis=0) / 1000.0) * 1000.0
    positions = {name: (float(x), float(y)) for (name, _, _), (x, y) in zip(rows, xy - corner, strict=True)}
    return positions, utm_from(zone, *corner.tolist(), south=south)


def _in_utm(degrees: FloatArray) -> tuple[int, bool, FloatArray]:
    """Return UTM zone, whether it is in the southern hemisphere, and UTM coordinates (N, 2) in m of *degrees*.

    *degrees* (N, 2) are longitude and latitude; their mean determines the zone.
    """
    zone = int((degrees[:, 0].mean() + 180.0) // 6.0) + 1
    south = bool(degrees[:, 1].mean() < 0.0)
    project = pyproj.Proj(f"+proj=utm +zone={zone}{' +south' if south else ''} +ellps=WGS84 +units=m")
    return zone, south, np.stack(project(degrees[:, 0], degrees[:, 1]), axis=-1)


def _projection(rows: Sequence[tuple[str, Element, Tags]], local_m: FloatArray) -> str | None:
    """Return the projection of *local_m* (N, 2) if it differs from the nodes' UTM coordinates by a constant offset."""
    try:
        degrees = np.array([[float(row.attrib["lon"]), float(row.attrib["lat"])] for _, row, _ in rows])
    except (KeyError, ValueError):
        return None
    if not len(degrees) or not (np.abs(degrees) <= (180.0, 84.0)).all():
        return None
    zone, south, xy = _in_utm(degrees)
    offset = np.median(xy - local_m, axis=0)
    is_constant = bool((np.abs(xy - local_m - offset) < SAME_PLACE_M).all())
    return utm_from(zone, *offset.tolist(), south=south) if is_constant else None


def _bounded_lane(row: _Relation, ways: _Ways, faults: MapFaults) -> BoundedLane | None:
    """Return the lane of a lanelet; None, with a note in *faults*, if a boundary is malformed."""
    try:
        left, right = _boundaries(row, ways)
    except ValueError as error:
        faults.add("lanelet malformed", f"lanelet {row.id!r} is left out: {error}")
        return None
    if row.tags.get("one_way") == "no":
        faults.notes["two-way lanelets taken in the direction in which they are drawn"] += 1
    left_tags, right_tags = (ways.tags[row.refs(side)[0]] for side in ("left", "right"))
    return BoundedLane(
        token=row.id,
        left_m=left,
        right_m=right,
        centre_m=lanelet_centre(left, right) if _usable(left) and _usable(right) else None,
        is_connector="turn_direction" in row.tags,
        use=USES[row.tags.get("subtype", "")],
        speed_mps=_speed(row.tags.get("speed_limit", ""), faults),
        left_dashed=_dashed(left_tags),
        right_dashed=_dashed(right_tags),
    )


def _usable(bound_m: FloatArray) -> bool:
    """Return whether a centre line can be drawn from a boundary (N, 2); otherwise its lane is left out later."""
    return bool(np.isfinite(bound_m).all() and np.abs(np.diff(bound_m, axis=0)).sum() < LONGEST_M)


def _boundaries(row: _Relation, ways: _Ways) -> tuple[FloatArray, FloatArray]:
    """Return left and right boundary in driving direction; boundaries drawn the other way are reversed."""
    sides = []
    for side in ("left", "right"):
        parts = [ways.points(ref) for ref in row.refs(side)]
        if not parts or any(len(part) < 2 for part in parts):
            raise ValueError(f"it has no {side} boundary")
        sides.append(_joined(parts))
    left, right = sides
    along = np.hypot(*(left[0] - right[0])) + np.hypot(*(left[-1] - right[-1]))
    across = np.hypot(*(left[0] - right[-1])) + np.hypot(*(left[-1] - right[0]))
    if across < along:
        right = right[::-1]
    ring = np.vstack((left, right[::-1]))
    area = float(np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1)))
    return (left[::-1], right[::-1]) if area > 0.0 else (left, right)


def _joined(parts: list[FloatArray]) -> FloatArray:
    """Return consecutive ways as one line, each reversed if necessary to begin where the one before ends."""
    line = parts[0]
    for part in parts[1:]:
        if np.hypot(*(line[0] - part[0])) < 1e-6 or np.hypot(*(line[0] - part[-1])) < 1e-6:
            line = line[::-1]
        part = part[::-1] if np.hypot(*(line[-1] - part[-1])) < np.hypot(*(line[-1] - part[0])) else part
        line = np.vstack((line, part[1:]))
    return line


def _speed(text: str, faults: MapFaults) -> float | None:
    """Return a speed limit in m/s (km/h if it has no unit, as in Lanelet2); None if it is absent or not understood."""
    if not text:
        return None
    parts = SPEED.fullmatch(text.lower())
    value = float(parts[1]) * UNITS_MPS.get(parts[2], 0.0) if parts else 0.0
    if 0.0 < value < np.inf:
        return value
    faults.notes["speed limits that are not understood"] += 1
    return None


def _dashed(tags: Tags) -> bool | None:
    """Return whether a line may be crossed, at least from one side; None if its type is unknown.

    By Lanelet2's rules (``LinestringTagging.md``) "lane_change" overrides the type. Of the types, only lines that are
    "dashed" ("solid_dashed" from one side) may be crossed.
    """
    stated = {STATED[tags[key]] for key in LANE_CHANGE if tags.get(key) in STATED}
    if stated:
        return True in stated
    kind = tags.get("type", "")
    if kind in ("line_thin", "line_thick"):
        return "dashed" in tags.get("subtype", "")
    return False if kind else None


def _with_neighbours(rows: list[BoundedLane], lanelets_for_vehicles: list[_Relation]) -> list[BoundedLane]:
    """Return *rows* with the left neighbour set: the lanelet whose right boundary is a lanelet's left boundary."""
    sides = {row.id: (row.refs("left"), row.refs("right")) for row in lanelets_for_vehicles}
    right_of = {ref: row.token for row in rows for ref in sides[row.token][1]}
    left_of = [next((right_of[ref] for ref in sides[row.token][0] if ref in right_of), None) for row in rows]
    return [replace(row, left_neighbour=left) for row, left in zip(rows, left_of, strict=True)]


def _with_successors(rows: list[BoundedLane]) -> list[BoundedLane]:
    """Return *rows* with the successors set: the lanelets that begin at both end points of a lanelet."""
    starts: dict[tuple[float, ...], list[str]] = defaultdict(list)
    for row in rows:
        starts[_end_key(row.left_m[0], row.right_m[0])].append(row.token)
    return [
        replace(row, successors=tuple(starts.get(_end_key(row.left_m[-1], row.right_m[-1]), ())))
        for row in rows
    ]


def _end_key(left: FloatArray, right: FloatArray) -> tuple[float, ...]:
    return tuple(np.concatenate((left, right)).round(3).tolist())


def _areas(lanelets: Iterable[_Relation], ways: _Ways, faults: MapFaults) -> dict[str, list[Polygon]]:
    """Return the areas of lanelets for pedestrians, by kind."""
    areas: dict[str, list[Polygon]] = {"crossings": [], "walkways": []}
    for row in lanelets:
        kind = ON_FOOT.get(row.tags.get("subtype", ""))
        if kind is not None:
            try:
                left, right = _boundaries(row, ways)
            except ValueError as error:
                faults.add("area malformed", f"lanelet {row.id!r} for people on foot is left out: {error}")
                continue
            area = largest_part(np.vstack((left, right[::-1])))
            if area is None:
                faults.add(
                    "area malformed", f"lanelet {row.id!r} for people on foot has no area and is left out"
                )
            areas[kind] += [] if area is None else [area]
    return areas


def _lines(row: _Relation, ways: _Ways) -> list[tuple[str, LineString]]:
    """Return the existing stop lines (``ref_line``) of a regulatory element, with their names."""
    lines = []
    for ref in row.refs("ref_line"):
        try:
            points = ways.points(ref)
        except ValueError:
            continue
        lines += [(ref, LineString(points))] if len(points) > 1 else []
    return lines


def _stop_lines(rules: Iterable[_Relation], ways: _Ways) -> list[StopLine]:
    kinds = {"all_way_stop": "STOP_SIGN", "right_of_way": "YIELD"}
    return [
        StopLine(name, line.buffer(HALF_LINE_M, cap_style="flat"), kinds[row.tags["subtype"]])
        for row in rules
        if row.tags.get("subtype") in kinds
        for name, line in _lines(row, ways)
    ]


def _signals(rules: Iterable[_Relation], lanelets: Iterable[_Relation], ways: _Ways) -> list[Signal]:
    users: dict[str, list[str]] = defaultdict(list)
    for lanelet in lanelets:
        for ref in lanelet.refs("regulatory_element"):
            users[ref].append(lanelet.id)
    signals = []
    for row in rules:
        if row.tags.get("subtype") == "traffic_light":
            lines = _lines(row, ways)
            signals.append(Signal(row.id, lines[0][1] if lines else None, lanes=tuple(users[row.id])))
    return signals
