"""Lays sidewalks along the kerbs between crossings, and walking areas where they meet."""

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

ASIDE_M = 1.5  # distance of a sidewalk's centre line from the carriageway
SIDEWALK_M = 2.0  # width of a sidewalk
CORNER_M = 25.0  # largest distance along the kerb between crossing ends that share a walking area
STUB_M = 60.0  # length of a sidewalk that leads to no other crossing
SHORTEST_M = 1.0  # length of the shortest sidewalk
CLEARANCE_M = 0.3  # gap between a crossing and the beginning of a sidewalk
_NEAR_M = 4.0  # largest distance of a crossing's end from its kerb
_OPEN_M = 3.0  # kerbs end at this distance from the side of a lane that leads out of the net
_OUTWARD_M = 8.0  # length of a sidewalk that continues a crossing without a kerb


@dataclass(frozen=True, eq=False)
class WalkingArea:
    """An area in which crossings end and sidewalks begin.

    Attributes:
        junction: the junction that it belongs to.
        ends: (number of crossing, side) of each crossing end in it; side 0 is the crossing's first end.
        kerb: number of the kerb that it lies at; -1 for none.
        first_m: arc length on the kerb at which it begins.
        last_m: arc length on the kerb at which it ends.
    """

    junction: str
    ends: tuple[tuple[int, int], ...]
    kerb: int = -1
    first_m: float = 0.0
    last_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Sidewalk:
    """A sidewalk.

    Attributes:
        origin: number of the walking area at which it begins.
        target: number of the walking area at which it ends; None for a dead end.
        line_m: (N, 2) centre line.
    """

    origin: int
    target: int | None
    line_m: FloatArray


def kerbs_of(road: Carriageway) -> list[LineString]:
    """Return kerbs: centre lines of possible sidewalks around the carriageway, cut where lanes lead out of the net."""
    outline = shapely.boundary(road.area.buffer(ASIDE_M, quad_segs=4)).simplify(0.05)
    open_ends = shapely.union_all([end.buffer(0.5 * width + _OPEN_M) for end, width in road.open_ends])
    rings = [LineString(part.coords) for part in shapely.get_parts(outline) if part.length > 2.0 * SHORTEST_M]
    kerbs: list[LineString] = []
    for ring in rings:
        remaining = ring.difference(open_ends)
        merged = linemerge(remaining) if isinstance(remaining, MultiLineString) else remaining
        kerbs += [part for part in shapely.get_parts(merged) if part.length > 2.0 * SHORTEST_M]
    return kerbs


def walking_areas(crossings: Sequence[CrossingLine], kerbs: Sequence[LineString]) -> list[WalkingArea]:
    """Return the walking areas at the ends of the crossings; those of one junction at one corner are joined."""
    tree = shapely.STRtree(kerbs)
    at_kerb: dict[int, list[WalkingArea]] = defaultdict(list)
    without_kerb = []
    for number, crossing in enumerate(crossings):
        for side in (0, 1):
            end = Point(crossing.ends_m[side])
            kerb_numbers = tree.query_nearest(end, max_distance=_NEAR_M).tolist() if len(kerbs) else []
            if not kerb_numbers:  # no kerb is near
                without_kerb.append(WalkingArea(crossing.junction, ((number, side),)))
                continue
            s_m, half_m = kerbs[kerb_numbers[0]].project(end), 0.5 * crossing.width_m + CLEARANCE_M
            at_kerb[kerb_numbers[0]].append(
                WalkingArea(crossing.junction, ((number, side),), kerb_numbers[0], s_m - half_m, s_m + half_m)
            )
    joined = [area for kerb in sorted(at_kerb) for area in _joined(at_kerb[kerb], kerbs[kerb])]
    return [*joined, *without_kerb]


def _joined(areas: list[WalkingArea], kerb: LineString) -> list[WalkingArea]:
    """Return *areas* ordered along *kerb*, those at one corner joined into one."""
    ordered = sorted(areas, key=lambda area: (area.first_m, area.ends))
    if kerb.is_closed and len(ordered) > 1:  # begin after the widest gap, so that no corner is cut in two
        gaps_m = [
            (ordered[(n + 1) % len(ordered)].first_m - area.last_m) % kerb.length
            for n, area in enumerate(ordered)
        ]
        start = (int(np.argmax(gaps_m)) + 1) % len(ordered)
        ordered = ordered[start:] + [_shifted(area, kerb.length) for area in ordered[:start]]
    merged = ordered[:1]
    for area in ordered[1:]:
        last = merged[-1]
        last_crossings = {number for number, _ in last.ends}
        is_same_corner = (
            area.junction == last.junction
            and area.first_m - last.last_m <= CORNER_M
            and last_crossings.isdisjoint(number for number, _ in area.ends)
        )
        if is_same_corner:
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
    """Return the sidewalks: along each kerb, over islands between crossings, and outwards from all other areas."""
    areas_of_kerb: dict[int, list[int]] = defaultdict(list)
    for number, area in enumerate(areas):
        areas_of_kerb[area.kerb].append(number)
    walks = [
        walk for k, numbers in areas_of_kerb.items() if k >= 0 for walk in _along(kerbs[k], numbers, areas)
    ]
    walks += _over_islands(areas, crossings)
    connected = {number for walk in walks for number in (walk.origin, walk.target)}
    for number, area in enumerate(areas):
        if number not in connected and (walk := _outwards(number, area, crossings, road)) is not None:
            walks.append(walk)
    return walks


def _along(kerb: LineString, numbers: list[int], areas: Sequence[WalkingArea]) -> Iterator[Sidewalk]:
    """Yield the sidewalks along *kerb* between its walking areas *numbers*, and beyond the outermost of them."""
    for origin, target in itertools.pairwise(numbers):
        line = _stretch(kerb, areas[origin].last_m, areas[target].first_m)
        if line is not None:
            yield Sidewalk(origin, target, line)
    first, last = areas[numbers[0]], areas[numbers[-1]]
    if kerb.is_closed:
        gap_m = first.first_m + kerb.length - last.last_m
        end = numbers[0] if len(numbers) > 1 else None
        length_m = gap_m if end is not None else min(STUB_M, 0.5 * gap_m)
        line = _stretch(kerb, last.last_m, last.last_m + length_m)
        if line is not None:
            yield Sidewalk(numbers[-1], end, line)
        return
    before = _stretch(kerb, max(first.first_m - STUB_M, 0.0), first.first_m)
    after = _stretch(kerb, last.last_m, min(last.last_m + STUB_M, kerb.length))
    if before is not None:
        yield Sidewalk(numbers[0], None, before[::-1])
    if after is not None:
        yield Sidewalk(numbers[-1], None, after)


def _stretch(kerb: LineString, start_m: float, end_m: float) -> FloatArray | None:
    """Return *kerb* (N, 2) between two arc lengths, which may exceed the length of a closed one; None if too short."""
    if end_m - start_m < SHORTEST_M:
        return None
    total_m = kerb.length
    turns = np.floor(start_m / total_m) if kerb.is_closed else 0.0
    start, end = start_m - turns * total_m, end_m - turns * total_m
    parts = [substring(kerb, start, min(end, total_m))]
    if end > total_m and kerb.is_closed:
        parts.append(substring(kerb, 0.0, end - total_m))
    points = np.vstack([np.asarray(part.coords) for part in parts if part.length > 0.0])
    keep = np.concatenate(([True], np.hypot(*np.diff(points, axis=0).T) > 1e-3))
    return np.asarray(points[keep]) if keep.sum() > 1 else None


def _over_islands(areas: Sequence[WalkingArea], crossings: Sequence[CrossingLine]) -> Iterator[Sidewalk]:
    """Yield the sidewalks over islands, from one part of a crossing to the next one at another junction."""
    area_of_end = {end: number for number, area in enumerate(areas) for end in area.ends}
    for number, (crossing, following) in enumerate(itertools.pairwise(crossings)):
        origin, target = area_of_end[number, 1], area_of_end[number + 1, 0]
        line = np.stack((crossing.ends_m[1], following.ends_m[0]))
        is_long_enough = np.hypot(*(line[1] - line[0])) >= SHORTEST_M
        if following.follows_island and is_long_enough and crossing.junction != following.junction:
            yield Sidewalk(origin, target, line)


def _outwards(
    number: int, area: WalkingArea, crossings: Sequence[CrossingLine], road: Carriageway
) -> Sidewalk | None:
    """Return a sidewalk that continues the first crossing of *area* straight on; None if it would meet a lane."""
    crossing, side = crossings[area.ends[0][0]], area.ends[0][1]
    end, other_end = crossing.ends_m[side], crossing.ends_m[1 - side]
    outward = (end - other_end) / crossing.length_m
    line = np.stack((end + CLEARANCE_M * outward, end + (CLEARANCE_M + _OUTWARD_M) * outward))
    return None if LineString(line).intersects(road.lanes_area) else Sidewalk(number, None, line)


def outline(area: WalkingArea, crossings: Sequence[CrossingLine], starts: Sequence[FloatArray]) -> Polygon:
    """Return the convex outline of the area's crossing ends and of the first two points (2, 2) of its sidewalks."""
    points = []
    for number, side in area.ends:
        crossing = crossings[number]
        points += _end_points(crossing.ends_m[side], crossing.ends_m[1 - side], crossing.width_m)
    for line in starts:
        points += _end_points(line[0], line[1], SIDEWALK_M)
    hull = MultiPoint(points).convex_hull
    return hull if isinstance(hull, Polygon) else hull.buffer(0.5)


def _end_points(xy_m: FloatArray, towards_m: FloatArray, width_m: float) -> list[FloatArray]:
    """Return the two corners at *xy_m* of a strip that leads to *towards_m*."""
    direction = (towards_m - xy_m) / np.hypot(*(towards_m - xy_m))
    half_across = 0.5 * width_m * np.array([-direction[1], direction[0]])
    return [xy_m - half_across, xy_m + half_across]
