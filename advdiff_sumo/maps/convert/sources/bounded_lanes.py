"""Turn lanes that a map states by their left and right boundaries into source lanes and links.

Used for Argoverse 2, CommonRoad, Lanelet2 and OpenDRIVE.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.sources.arcline import drop_repeats
from advdiff_sumo.maps.convert.sources.map_faults import MapFaults
from advdiff_sumo.maps.convert.sources.source_map import LaneUse, SourceLane

WIDEST_M = 30.0  # largest distance between the boundaries of a lane
FARTHEST_M = 1e8  # largest valid coordinate
LONGEST_M = 50_000.0  # a longer boundary must contain a wrong coordinate


@dataclass(frozen=True, eq=False)
class BoundedLane:
    """A lane as its map states it.

    Attributes:
        token: its name in the map.
        left_m, right_m: (N, 2) and (M, 2) boundaries in driving direction.
        is_connector: whether it lies in a junction.
        use: which vehicles may drive on it.
        speed_mps: speed limit, or None.
        successors, predecessors: tokens of the lanes after and before it.
        left_neighbour: token of the lane on its left, of either direction, or None.
        left_dashed: whether the marking on the left may be crossed; None: there is no marking.
        right_dashed: the same on the right.
        centre_m: (N, 2) centre line if the map states one; None: midway between the boundaries.
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
    """Return *places_m* (N, D) with NaN for impossible coordinates, so that their lanes are left out later."""
    return np.where(np.abs(places_m) <= FARTHEST_M, places_m, np.nan)


def midline(left_m: FloatArray, right_m: FloatArray) -> FloatArray:
    """Return the line (K, 2) midway between boundaries: the mean of their points if they have equally many."""
    if len(left_m) == len(right_m):
        return np.asarray(0.5 * (left_m + right_m))[:, :2]
    return midline_by_length(left_m, right_m)


def midline_by_length(left_m: FloatArray, right_m: FloatArray) -> FloatArray:
    """Return the line (K, 2) midway between points at equal shares of the lengths of two boundaries (N, 2 or 3).

    It has a point for each point of either boundary.
    """
    sides = [(line, _shares(line)) for line in (left_m, right_m)]
    all_shares = np.unique(np.concatenate([shares for _, shares in sides]).round(9))
    points = [
        np.stack([np.interp(all_shares, shares, line[:, axis]) for axis in (0, 1)], axis=-1)
        for line, shares in sides
    ]
    return np.asarray(0.5 * (points[0] + points[1]))


def _shares(line: FloatArray) -> FloatArray:
    """Return the arc length (N,) of each point of a 2D or 3D line as a share of the whole length."""
    lengths = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
    return np.asarray(lengths / max(lengths[-1], 1e-9))


def source_lanes(rows: Iterable[BoundedLane], faults: MapFaults) -> list[SourceLane]:
    """Return the usable lanes; the others are left out and noted in *faults*."""
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
    """Return each usable link once, and the number of stated links between lanes of the file.

    Either lane may state a link. Links to lanes that the file does not hold come from a clipped map; they are counted
    in *faults* and left out.
    """
    rows = list(rows)
    known, row_tokens = {lane.token for lane in lanes}, {row.token for row in rows}
    stated: dict[tuple[str, str], None] = {}
    for row in rows:
        stated.update(dict.fromkeys((other, row.token) for other in row.predecessors))
        stated.update(dict.fromkeys((row.token, other) for other in row.successors))
    inside = [link for link in stated if set(link) <= row_tokens]
    faults.notes["links beyond the rim of the map"] += len(stated) - len(inside)
    return [link for link in inside if set(link) <= known], len(inside)


def covered_area(lanes: Iterable[SourceLane]) -> MultiPolygon:
    """Return the area that the lanes cover, as the drivable area of maps that state none."""
    areas = [lane.polygon for lane in lanes if lane.polygon is not None]
    return as_multi(shapely.union_all(areas)) if areas else MultiPolygon()


def as_multi(shape: shapely.Geometry) -> MultiPolygon:
    """Return the polygons of any geometry as one MultiPolygon."""
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon) and part.area > 0]
    return MultiPolygon(parts)


def largest_part(ring: FloatArray) -> Polygon | None:
    """Return the polygon of *ring* (N, 2), or its largest valid part if it crosses itself; None if it is unusable."""
    if len(ring) < 3 or not np.isfinite(ring).all() or not _length_m(ring) <= LONGEST_M:
        return None
    polygon = Polygon(ring)
    if polygon.is_valid:
        return polygon if polygon.area > 0 else None
    return largest_valid(polygon)


def largest_valid(shape: BaseGeometry | None) -> Polygon | None:
    """Return the largest polygon of *shape* after it is made valid; None if there is none."""
    parts = MultiPolygon() if shape is None else as_multi(shapely.make_valid(shape))
    return max(parts.geoms, key=lambda part: part.area, default=None)


def _problem(row: BoundedLane) -> str | None:
    """Return why the boundaries of a lane are unusable, or None if they are usable."""
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
    """Return the length of a line (N, 2) in m; infinite if it exceeds the range of numbers."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _centre(row: BoundedLane) -> FloatArray:
    return midline(row.left_m, row.right_m) if row.centre_m is None else row.centre_m


def _shared_markings(rows: Mapping[str, BoundedLane]) -> dict[str, str]:
    """Return the left neighbours of lanes, if they have the same direction and the marking between may be crossed."""
    shared = {}
    for row in rows.values():
        left = rows.get(str(row.left_neighbour))
        if left is None or not row.left_dashed or _problem(row) or _problem(left):
            continue
        if math.dist(row.left_m[0], left.right_m[0]) < math.dist(row.left_m[0], left.right_m[-1]):
            shared[row.token] = left.token
    return shared


def _lane(row: BoundedLane, centre_m: FloatArray, shared: Mapping[str, str]) -> SourceLane:
    """Return a lane as a source lane; *shared* gives the left lane behind a dashed marking, by its right lane."""
    left_lane = shared.get(row.token)
    right_lanes = [right for right, left in shared.items() if left == row.token]
    return SourceLane(
        token=row.token,
        is_connector=row.is_connector,
        centre_m=centre_m,
        polygon=largest_part(np.vstack((row.left_m, row.right_m[::-1]))),
        use=row.use,
        speed_mps=row.speed_mps,
        left_dashed=_marking_names(row.token, left_lane) if left_lane else frozenset(),
        right_dashed=frozenset().union(*(_marking_names(right, row.token) for right in right_lanes)),
        left_solid=row.left_dashed is False,
        right_solid=row.right_dashed is False,
    )


def _marking_names(right: str, left: str) -> frozenset[str]:
    """Return names for the two end points of the marking between two lanes."""
    return frozenset(f"{right}|{left}|{end}" for end in (0, 1))
