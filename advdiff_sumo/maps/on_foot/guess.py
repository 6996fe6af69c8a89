"""Crossings for nets that have none: one over each arm of a junction at which ways meet."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.on_foot.carriageway import Carriageway, Strip

FASTEST_MPS = 13.9  # as netconvert's crossings.guess.speed-threshold
INSIDE_M = 2.5  # a crossing lies so far beyond the lane ends, towards the middle of the junction
DEPTH_M = 4.0
_SAME_ARM_COS, _APART_M, _AHEAD_M = 0.82, 20.0, 12.0


@dataclass(frozen=True, eq=False)
class _End:
    """An end of a lane at a junction: place, direction out of the junction (unit vector), width and speed."""

    place_m: FloatArray
    out: FloatArray
    width_m: float
    speed_mps: float


def guessed_crossings(road: Carriageway) -> list[Polygon]:
    """Return areas of crossings over the arms of junctions whose ways cross, where 50 km/h or less are allowed."""
    lines: dict[str, list[LineString]] = defaultdict(list)
    for strip in road.strips:
        if strip.junction:
            lines[strip.junction].append(strip.line)
    ends = _ends(road)
    areas = []
    for name in sorted(lines):
        own = lines[name]
        if len(shapely.STRtree(own).query(own, predicate="crosses")[0]):
            areas += [area for arm in _arms(ends[name]) if (area := _area(arm)) is not None]
    return areas


def _ends(road: Carriageway) -> dict[str, list[_End]]:
    """Return the lane ends at each junction, each once."""
    lanes = {strip.lane: strip for strip in road.strips if not strip.junction}
    ends: dict[str, dict[tuple[str, int], _End]] = defaultdict(dict)
    for (junction, _), row in road.links.items():
        for name, side in (
            (f"{row.get('from')}_{row.get('fromLane')}", -1),
            (f"{row.get('to')}_{row.get('toLane')}", 0),
        ):
            if name in lanes:
                ends[junction][name, side] = _end(lanes[name], side)
    return {junction: list(own.values()) for junction, own in ends.items()}


def _end(strip: Strip, side: int) -> _End:
    reach = min(0.5, strip.line.length)
    at = (0.0, reach) if side == 0 else (strip.line.length, strip.line.length - reach)
    place, inner = (np.asarray(strip.line.interpolate(s).coords[0]) for s in at)
    step = inner - place
    return _End(place, step / np.hypot(*step), strip.width_m, strip.speed_mps)


def _arms(ends: list[_End]) -> Iterator[list[_End]]:
    """Yield lane ends that lie side by side and lead out of the junction in one direction."""
    left = list(ends)
    while left:
        arm = [left.pop(0)]
        grown = True
        while grown:
            beside = [end for end in left if any(_one_arm(end, other) for other in arm)]
            grown = bool(beside)
            arm += beside
            left = [end for end in left if not any(end is other for other in beside)]
        yield arm


def _one_arm(one: _End, other: _End) -> bool:
    apart = other.place_m - one.place_m
    ahead = abs(_dot(apart, one.out))
    return (
        _dot(one.out, other.out) > _SAME_ARM_COS and ahead < _AHEAD_M and float(np.hypot(*apart)) < _APART_M
    )


def _area(arm: list[_End]) -> Polygon | None:
    """Return a rectangle across all lanes of *arm*, inside the junction; None where traffic is fast."""
    if max(end.speed_mps for end in arm) > FASTEST_MPS:
        return None
    out = np.sum([end.out for end in arm], axis=0)
    out = out / np.hypot(*out)
    left = np.array([-out[1], out[0]])
    place = min(_dot(end.place_m, out) for end in arm) - INSIDE_M
    sides = [(_dot(end.place_m, left), 0.5 * end.width_m) for end in arm]
    low, high = min(at - half for at, half in sides), max(at + half for at, half in sides)
    rows = ((place, low), (place, high), (place + DEPTH_M, high), (place + DEPTH_M, low))
    return Polygon([(forth - 0.5 * DEPTH_M) * out + side * left for forth, side in rows])


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the product of two vectors, to the same last bit on every machine, as BLAS's is not."""
    return float(a[0] * b[0] + a[1] * b[1])
