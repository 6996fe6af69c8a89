"""Lanes that a map gives by their left and right boundaries: Argoverse 2, CommonRoad, Lanelet2, nuPlan."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceLane

WIDEST_M = 30.0  # boundaries farther apart do not bound one lane
FARTHEST_M = 1e8  # no coordinate is larger
LONGEST_M = 50_000.0  # a boundary or the rim of an area that is longer has a coordinate that is none


@dataclass(frozen=True, eq=False)
class BoundedLane:
    """A lane as its map states it.

    Attributes:
        token: its name in the map.
        left_m, right_m: (N, 2) and (M, 2) boundaries in driving direction.
        is_connector: whether it lies in a junction.
        use: who may drive on it.
        speed_mps: speed limit, or None.
        successors, predecessors: tokens of the lanes after and before it.
        left_neighbour: token of the lane on its left, of either direction, or None.
        left_dashed: whether the marking on the left may be crossed; None: there is no marking.
        right_dashed: the same on the right.
        centre_m: (N, 2) centre line where the map states one; None: midway between the boundaries.
    """

    token: str
    left_m: FloatArray
    right_m: FloatArray
    is_connector: bool = False
    use: LaneUse = LaneUse.CAR
    speed_mps: float | None = None
    successors: tuple[str, ...] = ()
    predecessors: tuple[str, ...] = ()
    left_neighbour: str | None = None
    left_dashed: bool | None = None
    right_dashed: bool | None = None
    centre_m: FloatArray | None = None


def on_earth(places_m: FloatArray) -> FloatArray:
    """Return *places_m* (N, D) with NaN for coordinates that are none, so that their lanes are left out."""
    return np.where(np.abs(places_m) <= FARTHEST_M, places_m, np.nan)


def midline(left_m: FloatArray, right_m: FloatArray) -> FloatArray:
    """Return the line (K, 2) midway between boundaries: the mean of their points where they have as many."""
    if len(left_m) == len(right_m):
        return np.asarray(0.5 * (left_m + right_m))[:, :2]
    return midline_by_length(left_m, right_m)


def midline_by_length(left_m: FloatArray, right_m: FloatArray) -> FloatArray:
    """Return the line (K, 2) midway between places at equal shares of the lengths of two boundaries (N, 2 or 3).

    Its points lie where one of the boundaries has one.
    """
    sides = [(line, _shares(line)) for line in (left_m, right_m)]
    both = np.unique(np.concatenate([shares for _, shares in sides]).round(9))
    places = [
        np.stack([np.interp(both, shares, line[:, axis]) for axis in (0, 1)], axis=-1)
        for line, shares in sides
    ]
    return np.asarray(0.5 * (places[0] + places[1]))


def _shares(line: FloatArray) -> FloatArray:
    """Return the length (N,) up to each point of a line in two or three dimensions, as a share of the whole."""
    lengths = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
    return np.asarray(lengths / max(lengths[-1], 1e-9))


def source_lanes(rows: Iterable[BoundedLane], faults: MapFaults) -> list[SourceLane]:
    """Return the usable lanes; the others are left out, counted and told."""
    by_token = {row.token: row for row in rows}
    shared = _shared_markings(by_token)
    lanes = []
    for row in by_token.values():
        problem = _problem(row)
        centre = None if problem else drop_repeats(_centre(row))
        if centre is None or len(centre) < 2:
            faults.add("lane unusable", f"lane {row.token!r} is left out: {problem or 'it has no length'}")
            continue
        lanes.append(_lane(row, centre, shared))
    return lanes


def lane_links(
    rows: Iterable[BoundedLane], lanes: Iterable[SourceLane], faults: MapFaults
) -> tuple[list[tuple[str, str]], int]:
    """Return each usable link once, whichever side states it, and how many are stated.

    Links to lanes that the file does not hold are those of a clipped map; they are counted alone.
    """
    rows = list(rows)
    known, given = {lane.token for lane in lanes}, {row.token for row in rows}
    stated: dict[tuple[str, str], None] = {}
    for row in rows:
        stated.update(dict.fromkeys((other, row.token) for other in row.predecessors))
        stated.update(dict.fromkeys((row.token, other) for other in row.successors))
    inside = [link for link in stated if set(link) <= given]
    faults.notes["links beyond the rim of the map"] += len(stated) - len(inside)
    return [link for link in inside if set(link) <= known], len(inside)


def covered_area(lanes: Iterable[SourceLane]) -> MultiPolygon:
    """Return what the lanes cover: the drivable area of maps that state none."""
    areas = [lane.polygon for lane in lanes if lane.polygon is not None]
    return as_multi(shapely.union_all(areas)) if areas else MultiPolygon()


def as_multi(shape: shapely.Geometry) -> MultiPolygon:
    """Return the polygons of any geometry as one MultiPolygon."""
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon) and part.area > 0]
    return MultiPolygon(parts)


def largest_part(ring: FloatArray) -> Polygon | None:
    """Return the polygon of *ring* (N, 2), its largest valid part where it crosses itself, or None."""
    if len(ring) < 3 or not np.isfinite(ring).all() or not _length_m(ring) <= LONGEST_M:
        return None
    polygon = Polygon(ring)
    if polygon.is_valid:
        return polygon if polygon.area > 0 else None
    parts = as_multi(shapely.make_valid(polygon))
    return max(parts.geoms, key=lambda part: part.area, default=None)


def _problem(row: BoundedLane) -> str | None:
    for side, line in (("left", row.left_m), ("right", row.right_m)):
        if line.ndim != 2 or len(line) < 2:
            return f"its {side} boundary has fewer than two points"
        if not np.isfinite(line).all():
            return f"a coordinate of its {side} boundary is not finite"
        if not _length_m(line) <= LONGEST_M:
            return f"its {side} boundary is {_length_m(line):.0f} m long"
    start, end = math.dist(row.left_m[0], row.right_m[0]), math.dist(row.left_m[-1], row.right_m[-1])
    if max(start, end) > WIDEST_M:
        return f"its boundaries are {max(start, end):.0f} m apart"
    return None


def _length_m(line: FloatArray) -> float:
    """Return the length of a line; infinite where it is too long for a number."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _centre(row: BoundedLane) -> FloatArray:
    return midline(row.left_m, row.right_m) if row.centre_m is None else row.centre_m


def _shared_markings(rows: Mapping[str, BoundedLane]) -> dict[str, str]:
    """Return the left neighbour of each lane that runs its way behind a marking that may be crossed."""
    shared = {}
    for row in rows.values():
        other = rows.get(str(row.left_neighbour))
        if other is None or not row.left_dashed or _problem(row) or _problem(other):
            continue
        if math.dist(row.left_m[0], other.right_m[0]) < math.dist(row.left_m[0], other.right_m[-1]):
            shared[row.token] = other.token
    return shared


def _lane(row: BoundedLane, centre_m: FloatArray, shared: Mapping[str, str]) -> SourceLane:
    on_left = shared.get(row.token)
    on_right = [right for right, left in shared.items() if left == row.token]
    return SourceLane(
        token=row.token,
        is_connector=row.is_connector,
        centre_m=centre_m,
        polygon=largest_part(np.vstack((row.left_m, row.right_m[::-1]))),
        use=row.use,
        speed_mps=row.speed_mps,
        left_dashed=_names(row.token, on_left) if on_left else frozenset(),
        right_dashed=frozenset().union(*(_names(right, row.token) for right in on_right)),
        left_solid=row.left_dashed is False,
        right_solid=row.right_dashed is False,
    )


def _names(right: str, left: str) -> frozenset[str]:
    """Return the names of the two ends of the marking between two lanes."""
    return frozenset(f"{right}|{left}|{end}" for end in (0, 1))
