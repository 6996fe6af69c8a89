"""Sidewalks along the kerbs from crossing to crossing, and the walking areas at which they meet."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry import LineString, MultiLineString, MultiPoint, Point, Polygon
from shapely.ops import linemerge, substring

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.on_foot.carriageway import Carriageway
from advdiff_sumo.maps.on_foot.crossing_lines import CrossingLine

ASIDE_M = 1.5  # of the middle of a sidewalk from the kerb
SIDEWALK_M = 2.0  # width
CORNER_M = 25.0  # crossings of one junction that end within this along the kerb share a walking area
STUB_M = 60.0  # a sidewalk that leads to no other crossing ends after this
SHORTEST_M = 1.0  # of an edge
CLEARANCE_M = 0.3  # between a crossing and the beginning of a sidewalk
_NEAR_M = 4.0  # a crossing ends at a kerb within this
_OPEN_M = 3.0  # kerbs end so far beside a lane that leads out of the net
_AWAY_M = 8.0


@dataclass(frozen=True, eq=False)
class WalkingArea:
    """Where crossings end and sidewalks begin.

    Attributes:
        junction: the junction that it belongs to.
        ends: (crossing, side) of the crossings that end there; side 0 is the first of the crossing's ends.
        kerb: number of the kerb that it lies at; -1 for none.
        first_m, last_m: what it takes of that kerb, as arc lengths.
    """

    junction: str
    ends: tuple[tuple[int, int], ...]
    kerb: int = -1
    first_m: float = 0.0
    last_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Sidewalk:
    """A sidewalk between two walking areas; *target* is None where it ends.

    Attributes:
        origin, target: numbers of walking areas.
        line_m: (N, 2) middle of the sidewalk.
    """

    origin: int
    target: int | None
    line_m: FloatArray


def kerbs_of(road: Carriageway) -> list[LineString]:
    """Return lines beside the carriageway, closed around blocks and islands; they end where lanes leave the net."""
    outline = shapely.boundary(road.area.buffer(ASIDE_M, quad_segs=4)).simplify(0.05)
    gates = shapely.union_all([end.buffer(0.5 * width + _OPEN_M) for end, width in road.open_ends])
    rings = [LineString(part.coords) for part in shapely.get_parts(outline) if part.length > 2.0 * SHORTEST_M]
    kerbs: list[LineString] = []
    for ring in rings:
        rest = ring.difference(gates)
        merged = linemerge(rest) if isinstance(rest, MultiLineString) else rest
        kerbs += [part for part in shapely.get_parts(merged) if part.length > 2.0 * SHORTEST_M]
    return kerbs


def walking_areas(crossings: Sequence[CrossingLine], kerbs: Sequence[LineString]) -> list[WalkingArea]:
    """Return the walking areas at both ends of each crossing, neighbours of one junction joined at corners."""
    tree = shapely.STRtree(kerbs)
    at_kerb: dict[int, list[WalkingArea]] = defaultdict(list)
    alone = []
    for number, crossing in enumerate(crossings):
        for side in (0, 1):
            end = Point(crossing.ends_m[side])
            near = tree.query_nearest(end, max_distance=_NEAR_M).tolist() if len(kerbs) else []
            if not near:
                alone.append(WalkingArea(crossing.junction, ((number, side),)))
                continue
            s, half = kerbs[near[0]].project(end), 0.5 * crossing.width_m + CLEARANCE_M
            at_kerb[near[0]].append(
                WalkingArea(crossing.junction, ((number, side),), near[0], s - half, s + half)
            )
    joined = [area for kerb in sorted(at_kerb) for area in _joined(at_kerb[kerb], kerbs[kerb])]
    return [*joined, *alone]


def _joined(areas: list[WalkingArea], kerb: LineString) -> list[WalkingArea]:
    """Return *areas* in order along *kerb*, those at one corner as one."""
    ordered = sorted(areas, key=lambda area: (area.first_m, area.ends))
    if kerb.is_closed and len(ordered) > 1:  # begin behind the widest gap
        gaps = [
            (ordered[(n + 1) % len(ordered)].first_m - area.last_m) % kerb.length
            for n, area in enumerate(ordered)
        ]
        start = (int(np.argmax(gaps)) + 1) % len(ordered)
        ordered = ordered[start:] + [_shifted(area, kerb.length) for area in ordered[:start]]
    merged = ordered[:1]
    for area in ordered[1:]:
        last = merged[-1]
        ends_here = {number for number, _ in last.ends}
        one_corner = (
            area.junction == last.junction
            and area.first_m - last.last_m <= CORNER_M
            and ends_here.isdisjoint(number for number, _ in area.ends)
        )
        if one_corner:
            merged[-1] = replace(last, ends=(*last.ends, *area.ends), last_m=max(last.last_m, area.last_m))
        else:
            merged.append(area)
    return merged


def _shifted(area: WalkingArea, by_m: float) -> WalkingArea:
    return replace(area, first_m=area.first_m + by_m, last_m=area.last_m + by_m)


def sidewalks(
    areas: Sequence[WalkingArea],
    kerbs: Sequence[LineString],
    crossings: Sequence[CrossingLine],
    road: Carriageway,
) -> list[Sidewalk]:
    """Return sidewalks along each kerb between its walking areas, beyond the outermost, and at areas without a kerb."""
    by_kerb: dict[int, list[int]] = defaultdict(list)
    for number, area in enumerate(areas):
        by_kerb[area.kerb].append(number)
    walks = [walk for k, own in by_kerb.items() if k >= 0 for walk in _along(kerbs[k], own, areas)]
    walks += _islands(areas, crossings)
    served = {number for walk in walks for number in (walk.origin, walk.target)}
    for number, area in enumerate(areas):
        if number not in served and (walk := _outwards(number, area, crossings, road)) is not None:
            walks.append(walk)
    return walks


def _along(kerb: LineString, own: list[int], areas: Sequence[WalkingArea]) -> Iterator[Sidewalk]:
    for one, other in itertools.pairwise(own):
        line = _stretch(kerb, areas[one].last_m, areas[other].first_m)
        if line is not None:
            yield Sidewalk(one, other, line)
    first, last = areas[own[0]], areas[own[-1]]
    if kerb.is_closed:
        rest = first.first_m + kerb.length - last.last_m
        target = own[0] if len(own) > 1 else None
        reach = rest if target is not None else min(STUB_M, 0.5 * rest)
        line = _stretch(kerb, last.last_m, last.last_m + reach)
        if line is not None:
            yield Sidewalk(own[-1], target, line)
        return
    before = _stretch(kerb, max(first.first_m - STUB_M, 0.0), first.first_m)
    after = _stretch(kerb, last.last_m, min(last.last_m + STUB_M, kerb.length))
    if before is not None:
        yield Sidewalk(own[0], None, before[::-1])
    if after is not None:
        yield Sidewalk(own[-1], None, after)


def _stretch(kerb: LineString, start_m: float, end_m: float) -> FloatArray | None:
    """Return *kerb* from one arc length to a later one, round its end where it is closed; None if too short."""
    if end_m - start_m < SHORTEST_M:
        return None
    total = kerb.length
    turns = np.floor(start_m / total) if kerb.is_closed else 0.0
    start, end = start_m - turns * total, end_m - turns * total
    parts = [substring(kerb, start, min(end, total))]
    if end > total and kerb.is_closed:
        parts.append(substring(kerb, 0.0, end - total))
    points = np.vstack([np.asarray(part.coords) for part in parts if part.length > 0.0])
    keep = np.concatenate(([True], np.hypot(*np.diff(points, axis=0).T) > 1e-3))
    return np.asarray(points[keep]) if keep.sum() > 1 else None


def _islands(areas: Sequence[WalkingArea], crossings: Sequence[CrossingLine]) -> Iterator[Sidewalk]:
    """Yield the steps over islands, from one part of a crossing to the next."""
    area_of = {end: number for number, area in enumerate(areas) for end in area.ends}
    for number, (crossing, after) in enumerate(itertools.pairwise(crossings)):
        origin, target = area_of[number, 1], area_of[number + 1, 0]
        line = np.stack((crossing.ends_m[1], after.ends_m[0]))
        long_enough = np.hypot(*(line[1] - line[0])) >= SHORTEST_M
        if after.goes_on and long_enough and crossing.junction != after.junction:
            yield Sidewalk(origin, target, line)


def _outwards(
    number: int, area: WalkingArea, crossings: Sequence[CrossingLine], road: Carriageway
) -> Sidewalk | None:
    """Return a sidewalk straight on from the crossing; None where a lane is in the way."""
    crossing, side = crossings[area.ends[0][0]], area.ends[0][1]
    end, other = crossing.ends_m[side], crossing.ends_m[1 - side]
    out = (end - other) / crossing.length_m
    line = np.stack((end + CLEARANCE_M * out, end + (CLEARANCE_M + _AWAY_M) * out))
    return None if LineString(line).intersects(road.lanes_area) else Sidewalk(number, None, line)


def outline(area: WalkingArea, crossings: Sequence[CrossingLine], begins: Sequence[FloatArray]) -> Polygon:
    """Return the area that holds the ends of its crossings and the beginnings (2, 2) of its sidewalks."""
    points = []
    for number, side in area.ends:
        crossing = crossings[number]
        points += _bar(crossing.ends_m[side], crossing.ends_m[1 - side], crossing.width_m)
    for line in begins:
        points += _bar(line[0], line[1], SIDEWALK_M)
    hull = MultiPoint(points).convex_hull
    return hull if isinstance(hull, Polygon) else hull.buffer(0.5)


def _bar(place: FloatArray, towards: FloatArray, width_m: float) -> list[FloatArray]:
    step = (towards - place) / np.hypot(*(towards - place))
    half = 0.5 * width_m * np.array([-step[1], step[0]])
    return [place - half, place + half]
