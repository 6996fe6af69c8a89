"""Read the lanelets of CommonRoad scenarios 2020a (Althoff et al. 2017, DOI 10.1109/IVS.2017.7995802).

Coordinates are those of the XML file in m. Boundaries run in driving direction, with equally many points on both sides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from shapely.geometry import LineString, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.sources.bounded_lanes import (
    BoundedLane,
    covered_area,
    lane_links,
    largest_part,
    source_lanes,
)
from advdiff_sumo.maps.convert.sources.georeference import PlanarTransform, stated_projection
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.source_map import (
    CIRCULAR,
    Direction,
    Lamp,
    LaneUse,
    Signal,
    SourceLane,
    SourceMap,
    StatedSizes,
    StopLine,
)

REMEDY = "give an unchanged CommonRoad scenario of version 2020a"
USES = {"busLane": LaneUse.BUS, "bicycleLane": LaneUse.BICYCLE}
ON_FOOT = {"crosswalk", "sidewalk"}
SPEED_SIGNS = {"274", "R2-1", "274.1", "302_vienna"}  # speed limits; their values are in m/s
STOP_SIGNS, YIELD_SIGNS = {"206", "R1-1"}, {"205", "R1-2"}
ARROWS = {
    "left": frozenset({Direction.LEFT}),
    "straight": frozenset({Direction.STRAIGHT}),
    "right": frozenset({Direction.RIGHT}),
    "leftStraight": frozenset({Direction.LEFT, Direction.STRAIGHT}),
    "straightRight": frozenset({Direction.STRAIGHT, Direction.RIGHT}),
    "leftRight": frozenset({Direction.LEFT, Direction.RIGHT}),
}
HALF_LINE_M = 0.25  # half the depth of a painted stop line


def commonroad_map(root: Element, path: Path) -> SourceMap:
    """Return the lanelet network below *root*, read from *path*.

    Lanelets that an intersection names as successors of its incoming lanelets are connectors. If the file has no
    intersection, connectors are found later by geometry. Crosswalks and sidewalks become areas, not lanes.

    Raises:
        MapError: another format or version, or no lanelet is usable.
    """
    _check_format(root, path)
    faults = MapFaults(path)
    connectors = {ref for row in root.iterfind("intersection/incoming") for ref in _successors(row)}
    limits, rules = _signs(root)
    lanelets = [row for row in root.iterfind("lanelet") if _kinds(row).isdisjoint(ON_FOOT)]
    rows = [lane for row in lanelets if (lane := _bounded_lane(row, connectors, limits, faults))]
    lanes = source_lanes(rows, faults)
    if not lanes:
        raise MapError(path, "holds no usable lanelet", REMEDY)
    known = {lane.token for lane in lanes}
    links, stated = lane_links(rows, lanes, faults)
    projection = _projection(root.find("location/geoTransformation"), faults)
    return SourceMap(
        path=path,
        location=root.get("benchmarkID") or path.name.split(".")[0],
        lanes=tuple(lanes),
        links=tuple(links),
        drivable=covered_area(lanes),
        crossings=tuple(_areas(root, "crosswalk", faults)),
        walkways=tuple(_areas(root, "sidewalk", faults)),
        stop_lines=tuple(_stop_lines(root, lanes, rules)),
        signals=tuple(_signals(root)),
        stated=StatedSizes(len(lanelets), stated),
        left_out=tuple(name for row in lanelets if (name := row.get("id", "")) not in known),
        notes=faults.notes,
        warnings=faults.sentences(),
        projection=projection,
    )


def _projection(row: Element | None, faults: MapFaults) -> str | None:
    """Return the projection that a scenario states; ``gpsLatitude`` alone determines no frame."""
    if row is None:
        return None
    tags = {"x_m": "xTranslation", "y_m": "yTranslation", "turned_rad": "zRotation", "scale": "scaling"}
    texts = {key: row.findtext(f"additionalTransformation/{tag}") for key, tag in tags.items()}
    try:
        transform = PlanarTransform(**{key: float(text) for key, text in texts.items() if text})
    except ValueError:
        transform = PlanarTransform(x_m=math.nan)
    return stated_projection(row.findtext("geoReference"), transform, faults)


def _check_format(root: Element, path: Path) -> None:
    """Raise a MapError if *root* is no CommonRoad scenario of a known version with a lanelet."""
    if root.tag != "commonRoad":
        raise MapError(path, f"begins with <{root.tag}>, so it is no CommonRoad scenario", REMEDY)
    version = root.get("commonRoadVersion")
    if version is None or not version.startswith("20"):
        raise MapError(path, f"states CommonRoad version {version!r}", REMEDY)
    if root.find("lanelet") is None:
        raise MapError(path, "holds no lanelet", "give a scenario with a road network")


def _successors(incoming: Element) -> Iterator[str]:
    for tag in ("successorsLeft", "successorsStraight", "successorsRight"):
        yield from (row.get("ref", "") for row in incoming.iterfind(tag))


def _kinds(row: Element) -> set[str]:
    return {(kind.text or "").strip() for kind in row.iterfind("laneletType")}


def _signs(root: Element) -> tuple[dict[str, float], dict[str, str]]:
    """Return, by id of the traffic sign, speed limits in m/s, and STOP_SIGN or YIELD."""
    limits: dict[str, float] = {}
    rules: dict[str, str] = {}
    for sign in root.iterfind("trafficSign"):
        name = sign.get("id", "")
        for element in sign.iterfind("trafficSignElement"):
            kind = (element.findtext("trafficSignID") or "").strip()
            if kind in SPEED_SIGNS:
                _store_limit(limits, name, element.findtext("additionalValue"))
            elif kind in STOP_SIGNS | YIELD_SIGNS:
                rules[name] = "STOP_SIGN" if kind in STOP_SIGNS else "YIELD"
    return limits, rules


def _store_limit(limits: dict[str, float], name: str, text: str | None) -> None:
    """Add the speed limit *text* to *limits* if it is a positive number."""
    try:
        value = float(text or "")
    except ValueError:
        return
    if np.isfinite(value) and value > 0.0:
        limits[name] = value


def _bounded_lane(
    row: Element, connectors: set[str], limits: dict[str, float], faults: MapFaults
) -> BoundedLane | None:
    """Return the lane of a lanelet; None, with a note in *faults*, if a boundary is malformed."""
    name = row.get("id", "")
    speeds = [limits[ref] for ref in _refs(row, "trafficSignRef") if ref in limits]
    _store_limit(limits, f"{name} own", row.findtext("speedLimit"))  # version 2018b
    speeds += [limits[f"{name} own"]] if f"{name} own" in limits else []
    kinds = _kinds(row)
    try:
        left, right = _boundary(row, "leftBound"), _boundary(row, "rightBound")
    except ValueError as error:
        faults.add("lanelet malformed", f"lanelet {name!r} is left out: {error}")
        return None
    return BoundedLane(
        token=name,
        left_m=left,
        right_m=right,
        is_connector=name in connectors,
        use=next((use for kind, use in USES.items() if kind in kinds), LaneUse.CAR),
        speed_mps=min(speeds, default=None),
        successors=tuple(_refs(row, "successor")),
        predecessors=tuple(_refs(row, "predecessor")),
        left_neighbour=_left_neighbour(row),
        left_dashed=_dashed(row, "leftBound"),
        right_dashed=_dashed(row, "rightBound"),
    )


def _refs(row: Element, tag: str) -> list[str]:
    return [reference.get("ref", "") for reference in row.iterfind(tag)]


def _left_neighbour(row: Element) -> str | None:
    beside = row.find("adjacentLeft")
    return beside.get("ref") if beside is not None and beside.get("drivingDir") == "same" else None


def _dashed(row: Element, side: str) -> bool | None:
    """Return whether the marking of boundary *side* may be crossed; None if there is no marking."""
    mark = (row.findtext(f"{side}/lineMarking") or "").strip()
    return None if mark in ("", "unknown", "no_marking") else "dashed" in mark


def _boundary(row: Element, side: str) -> FloatArray:
    boundary = row.find(side)
    if boundary is None:
        raise ValueError(f"it has no {side}")
    return _points(boundary.iterfind("point"))


def _points(rows: Iterator[Element]) -> FloatArray:
    text = [(row.findtext("x") or "", row.findtext("y") or "") for row in rows]
    try:
        return np.array([[float(x), float(y)] for x, y in text], dtype=np.float64).reshape(-1, 2)
    except ValueError:
        raise ValueError("a coordinate of a boundary is no number") from None


def _areas(root: Element, kind: str, faults: MapFaults) -> Iterator[Polygon]:
    """Yield the areas of the lanelets of one *kind*."""
    for row in root.iterfind("lanelet"):
        if kind in _kinds(row):
            try:
                ring = np.vstack((_boundary(row, "leftBound"), _boundary(row, "rightBound")[::-1]))
                area = largest_part(ring)
            except ValueError as error:
                faults.add("area malformed", f"{kind} {row.get('id', '')!r} is left out: {error}")
                continue
            if area is None:
                faults.add("area malformed", f"{kind} {row.get('id', '')!r} has no area and is left out")
            else:
                yield area


def _stop_lines(root: Element, lanes: list[SourceLane], rules: dict[str, str]) -> Iterator[StopLine]:
    """Yield a stop line at the end of each lanelet with a stop or yield sign."""
    by_token = {lane.token: lane for lane in lanes}
    for row in root.iterfind("lanelet"):
        lane = by_token.get(row.get("id", ""))
        kinds = {rules[ref] for ref in _refs(row, "trafficSignRef") if ref in rules}
        if lane is not None and kinds:
            yield StopLine(lane.token, _end_bar(lane), min(kinds))


def _end_bar(lane: SourceLane) -> Polygon:
    """Return the area of a stop line across the end of *lane*, from 1 m left to 1 m right of its centre line."""
    before, end = lane.centre_m[-2:]
    across = polyline.left_of(polyline.direction(before, end))
    return LineString([end - across, end + across]).buffer(HALF_LINE_M, cap_style="flat")


def _signals(root: Element) -> Iterator[Signal]:
    """Yield the traffic lights with the lanelets that refer to them."""
    lanes: dict[str, list[str]] = {}
    for row in root.iterfind("lanelet"):
        at_line = [light.get("ref", "") for light in row.iterfind("stopLine/trafficLightRef")]
        for ref in dict.fromkeys((*_refs(row, "trafficLightRef"), *at_line)):
            lanes.setdefault(ref, []).append(row.get("id", ""))
    for light in root.iterfind("trafficLight"):
        name = light.get("id", "")
        yield Signal(name, None, lanes=tuple(lanes.get(name, ())), lamps=_lamps(light.findtext("direction")))


def _lamps(direction: str | None) -> frozenset[Lamp]:
    """Return the lamp of a light by its stated *direction*; no lamp if it states no known direction."""
    name = (direction or "").strip()
    if name == "all":
        return frozenset({CIRCULAR})
    return frozenset({Lamp(ARROWS[name], protected=True, exclusive=True)}) if name in ARROWS else frozenset()
