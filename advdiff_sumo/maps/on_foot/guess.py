"""Guesses crossings for nets that have none: one over each arm of a junction on which paths cross."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.on_foot.carriageway import Carriageway, Strip

FASTEST_MPS = 13.9  # no crossings over faster arms; as netconvert's crossings.guess.speed-threshold
INSIDE_M = 2.5  # distance of a crossing from the lane ends, towards the middle of the junction
DEPTH_M = 4.0  # width of a crossing, along the arm
# lane ends belong to one arm up to these differences:
_SAME_ARM_COS = 0.82  # smallest cosine of the angle between their directions
_SAME_ARM_M, _SAME_ARM_ALONG_M = 20.0, 12.0  # largest distance, in total and along the arm


@dataclass(frozen=True, eq=False)
class _End:
    """An end of a lane at a junction: position, direction out of the junction (unit vector), width and speed limit."""

    xy_m: FloatArray
    outward: FloatArray
    width_m: float
    speed_mps: float


def guessed_crossings(road: Carriageway) -> list[Polygon]:
    """Return the outlines of crossings over the arms, with limits up to 50 km/h, of junctions on which paths cross."""
    lines: dict[str, list[LineString]] = defaultdict(list)
    for strip in road.strips:
        if strip.junction:
            lines[strip.junction].append(strip.line)
    ends = _ends(road)
    areas = []
    for name in sorted(lines):
        paths = lines[name]
        if len(shapely.STRtree(paths).query(paths, predicate="crosses")[0]):
            areas += [area for arm in _arms(ends[name]) if (area := _area(arm)) is not None]
    return areas


def _ends(road: Carriageway) -> dict[str, list[_End]]:
    """Return junction → lane ends at it, without duplicates."""
    lanes = {strip.lane: strip for strip in road.strips if not strip.junction}
    ends: dict[str, dict[tuple[str, int], _End]] = defaultdict(dict)
    for (junction, _), connection in road.links.items():
        for name, side in (
            (f"{connection.get('from')}_{connection.get('fromLane')}", -1),
            (f"{connection.get('to')}_{connection.get('toLane')}", 0),
        ):
            if name in lanes:
                ends[junction][name, side] = _end(lanes[name], side)
    return {junction: list(own_ends.values()) for junction, own_ends in ends.items()}


def _end(lane: Strip, side: int) -> _End:
    """Return the beginning (*side* 0) or the end (*side* −1) of a lane."""
    step_m = min(0.5, lane.line.length)
    s_m = (0.0, step_m) if side == 0 else (lane.line.length, lane.line.length - step_m)
    xy, inner_xy = (np.asarray(lane.line.interpolate(s).coords[0]) for s in s_m)
    step = inner_xy - xy
    return _End(xy, step / np.hypot(*step), lane.width_m, lane.speed_mps)


def _arms(ends: list[_End]) -> Iterator[list[_End]]:
    """Yield the lane ends of each arm: those side by side that lead out of the junction in the same direction."""
    rest = list(ends)
    while rest:
        arm = [rest.pop(0)]
        has_grown = True
        while has_grown:
            added = [end for end in rest if any(_is_same_arm(end, other) for other in arm)]
            has_grown = bool(added)
            arm += added
            rest = [end for end in rest if not any(end is other for other in added)]
        yield arm


def _is_same_arm(end: _End, other: _End) -> bool:
    offset = other.xy_m - end.xy_m
    along_m = abs(_dot(offset, end.outward))
    is_near = along_m < _SAME_ARM_ALONG_M and float(np.hypot(*offset)) < _SAME_ARM_M
    return is_near and _dot(end.outward, other.outward) > _SAME_ARM_COS


def _area(arm: list[_End]) -> Polygon | None:
    """Return a rectangle inside the junction across all lanes of *arm*; None if its speed limit is too high."""
    if max(end.speed_mps for end in arm) > FASTEST_MPS:
        return None
    outward = np.sum([end.outward for end in arm], axis=0)
    outward = outward / np.hypot(*outward)
    left = np.array([-outward[1], outward[0]])
    near_m = min(_dot(end.xy_m, outward) for end in arm) - INSIDE_M
    far_m = near_m + DEPTH_M
    lanes = [(_dot(end.xy_m, left), 0.5 * end.width_m) for end in arm]
    right_m, left_m = min(d - half for d, half in lanes), max(d + half for d, half in lanes)
    corners = ((near_m, right_m), (near_m, left_m), (far_m, left_m), (far_m, right_m))
    return Polygon([(s - 0.5 * DEPTH_M) * outward + d * left for s, d in corners])


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the dot product of two vectors (2,); unlike BLAS's, the last bit is the same on every machine."""
    return float(a[0] * b[0] + a[1] * b[1])
