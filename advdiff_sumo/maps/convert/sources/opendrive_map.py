"""Read OpenDRIVE maps (ASAM OpenDRIVE 1.4 to 1.8): lanes of an ``.xodr`` file, named ROAD_SECTION_LANE.

Elevation and superelevation are ignored; positions are those of the plan view.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from shapely.geometry import Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import MapError
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.bounded_lanes import (
    WIDEST_M,
    BoundedLane,
    covered_area,
    lane_links,
    largest_part,
    source_lanes,
)
from advdiff_sumo.maps.convert.sources.georeference import PlanarTransform, stated_projection
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.opendrive_curves import (
    ReferenceLine,
    cubics,
    number,
    stations,
    value_at,
)
from advdiff_sumo.maps.convert.sources.opendrive_links import SIDES, lane_successors, sections_of
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceMap, StatedSizes

REMEDY = "give an unchanged OpenDRIVE file (.xodr)"
NARROWEST_M = 0.1  # lanes that are nowhere wider are left out
STEP_M = 0.25  # distance between sample points on a reference line
CHORD_M = 0.001  # sample points nearer to the chord between others are left out
CAR_TYPES = (
    *("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "bidirectional"),
    *("mwyEntry", "mwyExit"),
)
USES = dict.fromkeys(CAR_TYPES, LaneUse.CAR) | {
    "bus": LaneUse.BUS,
    "taxi": LaneUse.BUS,
    "biking": LaneUse.BICYCLE,
}
UNITS_MPS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
KEEPS_LEFT = "header/userData[@code='traffic'][@value='left']"  # as maps/convert/opendrive.py writes it
Token: TypeAlias = str


def opendrive_map(root: Element, path: Path) -> SourceMap:
    """Return the map in the OpenDRIVE document *root*; roads inside junctions are connectors.

    Raises:
        MapError: another format, or no lane for vehicles is usable.
    """
    if root.tag != "OpenDRIVE":
        raise MapError(path, f"begins with <{root.tag}>, so it is no OpenDRIVE file", REMEDY)
    faults = MapFaults(path)
    roads = [road for row in root.iterfind("road") if (road := _read_road(row, faults))]
    successors = lane_successors(root)
    rows = [lane for road in roads for lane in road.lanes(successors, faults)]
    lanes = source_lanes(rows, faults)
    if not lanes:
        raise MapError(path, "holds no usable lane for vehicles", REMEDY)
    links, stated = lane_links(rows, lanes, faults)
    known = {lane.token for lane in lanes}
    projection = stated_projection(root.findtext("header/geoReference"), _offset_transform(root), faults)
    return SourceMap(
        path=path,
        location=path.name.removesuffix(".gz").removesuffix(".xodr"),
        lanes=tuple(lanes),
        links=tuple(links),
        drivable=covered_area(lanes),
        walkways=tuple(area for road in roads for area in road.areas("sidewalk", "walking")),
        carparks=tuple(area for road in roads for area in road.areas("parking")),
        stated=StatedSizes(len(rows), stated),
        left_out=tuple(row.token for row in rows if row.token not in known),
        notes=faults.notes,
        warnings=faults.sentences(),
        projection=projection,
        keeps_left=root.find(KEEPS_LEFT) is not None or any(road.left_hand for road in roads),
    )


def _offset_transform(root: Element) -> PlanarTransform:
    """Return the header's ``offset``: the transform from coordinates of the file to those of its ``geoReference``."""
    row = root.find("header/offset")
    if row is None:
        return PlanarTransform()
    try:
        return PlanarTransform(number(row, "x", 0.0), number(row, "y", 0.0), number(row, "hdg", 0.0))
    except ValueError:
        return PlanarTransform(x_m=math.nan)


@dataclass(frozen=True, eq=False)
class _Strip:
    """A lane of one section: inner border, outer border and middle line (N, 2), drawn along the reference line."""

    row: Element
    number: int
    inner_m: FloatArray
    outer_m: FloatArray
    middle_m: FloatArray


@dataclass(frozen=True, eq=False)
class _SideSection:
    """A lane section of one side of a road: its number on that side, its beginning, and its lanes."""

    section: int
    start_m: float
    strips: list[_Strip]


class _Road:
    """One road with its lanes; malformed roads raise a ValueError."""

    def __init__(self, row: Element) -> None:
        self.row, self.id = row, "_".join((row.get("id") or "").split())
        self.line = ReferenceLine(row.findall("planView/geometry"))
        self.offset = cubics(row.findall("lanes/laneOffset"), "s")
        self.left_hand = row.get("rule") == "LHT"
        self.limits = [(number(kind, "s", 0.0), _speed(kind.find("speed"))) for kind in row.findall("type")]
        self.centre_lanes = [
            (number(c, "s"), c.find("center/lane")) for c in row.findall("lanes/laneSection")
        ]
        if not self.centre_lanes:
            raise ValueError("it has no <laneSection>")
        self.side_sections = sorted(
            (part for side in SIDES for part in self._side_sections(side)), key=lambda part: part.section
        )

    def lanes(self, successors: dict[Token, tuple[Token, ...]], faults: MapFaults) -> Iterator[BoundedLane]:
        """Yield the lanes for vehicles, drawn in driving direction; *successors* are the tokens that follow a token."""
        for part in self.side_sections:
            for strip in part.strips:
                use = USES.get(strip.row.get("type", ""))
                if use is None:
                    continue
                token = f"{self.id}_{part.section}_{strip.number}"
                if len(drop_repeats(strip.middle_m)) < 2 or not NARROWEST_M < _width_m(strip) <= WIDEST_M:
                    faults.notes["lanes without a usable width or length left out"] += 1
                    continue
                yield self._lane(token, strip, use, part, successors)

    def areas(self, *kinds: str) -> Iterator[Polygon]:
        """Yield the areas of lanes whose type is one of *kinds*."""
        for strip in (s for part in self.side_sections for s in part.strips if s.row.get("type") in kinds):
            area = largest_part(np.vstack((strip.inner_m, strip.outer_m[::-1])))
            if area is not None:
                yield area

    def _side_sections(self, side: str) -> Iterator[_SideSection]:
        """Yield the lane sections of one *side* ("left" or "right")."""
        sections = sections_of(self.row, side)
        starts = [number(section, "s") for section in sections]
        for index, end_m in enumerate([*starts[1:], self.line.length_m] if starts else ()):
            yield _SideSection(index, starts[index], list(self._strips(sections[index], side, end_m)))

    def _strips(self, section: Element, side: str, end_m: float) -> Iterator[_Strip]:
        """Yield the lanes on one *side* of a section that ends at arc length *end_m*, from the middle outwards."""
        start, sign = number(section, "s"), 1 if side == "left" else -1
        if end_m - start < 1e-3:
            return
        s = stations(self.line, start, end_m, STEP_M)
        xy, yaw = self.line.at(s)
        normal = np.stack((-np.sin(yaw), np.cos(yaw)), axis=-1)
        inner = value_at(self.offset, s)
        for row in sorted(section.findall(f"{side}/lane"), key=lambda lane: abs(number(lane, "id"))):
            borders = row.findall("border")
            if borders and not row.findall("width"):
                outer = value_at(self.offset, s) + value_at(cubics(borders, base_m=start), s)
            else:
                outer = inner + sign * value_at(cubics(row.findall("width"), base_m=start), s)
            lines = [xy + offset[:, None] * normal for offset in (inner, outer, 0.5 * (inner + outer))]
            yield _Strip(row, int(number(row, "id")), lines[0], lines[1], lines[2])
            inner = outer

    def _lane(
        self,
        token: Token,
        strip: _Strip,
        use: LaneUse,
        part: _SideSection,
        successors: dict[Token, tuple[Token, ...]],
    ) -> BoundedLane:
        """Return a lane in driving direction: along the reference line if its id is negative, in right-hand traffic.

        In left-hand traffic, lanes with a positive id run along the reference line.
        """
        along = (strip.number < 0) != self.left_hand
        lines = [line if along else line[::-1] for line in (strip.inner_m, strip.outer_m, strip.middle_m)]
        inner, outer, middle = (_simplified(line) for line in lines)
        marks = {lane.number: lane.row for lane in part.strips} | {0: self._centre_lane(part.start_m)}
        step = 1 if strip.number < 0 else -1
        inwards, outwards = ("increase", "decrease")[::step]
        outer_dashed = _dashed(strip.row, outwards)
        inner_dashed = _dashed(marks.get(strip.number + step), inwards)
        left = strip.number + (-step if self.left_hand else step)
        has_left_neighbour = left in marks and left * strip.number > 0
        return BoundedLane(
            token=token,
            left_m=outer if self.left_hand else inner,
            right_m=inner if self.left_hand else outer,
            is_connector=self.row.get("junction", "-1") not in ("-1", ""),
            use=use,
            speed_mps=_speed(strip.row.find("speed")) or self._limit_at(part.start_m),
            successors=successors.get(token, ()),
            left_neighbour=f"{self.id}_{part.section}_{left}" if has_left_neighbour else None,
            left_dashed=outer_dashed if self.left_hand else inner_dashed,
            right_dashed=inner_dashed if self.left_hand else outer_dashed,
            centre_m=middle,
        )

    def _centre_lane(self, s_m: float) -> Element | None:
        """Return the centre lane (id 0) at an arc length; sections of a single side may leave it out."""
        before = [(start, lane) for start, lane in self.centre_lanes if start <= s_m and lane is not None]
        return sorted(before, key=lambda pair: pair[0])[-1][1] if before else None

    def _limit_at(self, s_m: float) -> float | None:
        return next((limit for start, limit in reversed(self.limits) if start <= s_m + 1e-6), None)


def _read_road(row: Element, faults: MapFaults) -> _Road | None:
    """Return the road of *row*; None, with a note in *faults*, if it is malformed."""
    try:
        return _Road(row)
    except ValueError as error:
        faults.add("road malformed", f"road {row.get('id', '')!r} is left out: {error}")
        return None


def _width_m(strip: _Strip) -> float:
    """Return the largest width of a lane in m."""
    return float(np.hypot(*(strip.outer_m - strip.inner_m).T).max())


def _simplified(line: FloatArray) -> FloatArray:
    kept = drop_repeats(line)
    return np.asarray(shapely.LineString(kept).simplify(CHORD_M).coords) if len(kept) > 1 else line[[0, -1]]


def _dashed(lane: Element | None, towards: str) -> bool | None:
    """Return whether the outer border of *lane* may be crossed anywhere; None if no marking states it.

    A marking's ``laneChange`` overrides its type. "increase" and "decrease" allow changes to higher and lower lane ids;
    *towards* is the direction in question.
    """
    allowed = [_allows(mark, towards) for mark in (() if lane is None else lane.iterfind("roadMark"))]
    return True if True in allowed else None if None in allowed or not allowed else False


def _allows(mark: Element, towards: str) -> bool | None:
    stated, kind = mark.get("laneChange"), mark.get("type", "none")
    if stated is not None:
        return stated in ("both", towards)
    return None if kind == "none" else "broken" in kind


def _speed(row: Element | None) -> float | None:
    """Return a speed limit in m/s; None if it is absent, ``no limit`` or ``undefined``."""
    try:
        value = float("" if row is None else row.get("max", ""))
        factor = UNITS_MPS["m/s" if row is None else row.get("unit", "m/s")]
    except (ValueError, KeyError):
        return None
    return value * factor if np.isfinite(value) and value > 0.0 else None
