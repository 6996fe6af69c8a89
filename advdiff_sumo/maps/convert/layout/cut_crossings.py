"""Cut or shorten edges at pedestrian crossings, since SUMO allows crossings in junctions only."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.lane_segments import ROOM_M, Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout
from advdiff_sumo.maps.on_foot.carriageway import NARROW_M
from advdiff_sumo.maps.on_foot.crossing_lines import (
    LEAST_SINE,
    LONGEST_M,
    MOST_WIDTH_M,
    REACH_M,
    Band,
    band_of,
    direction_where_met,
)

SHORTEST_M = 5.0  # shortest edge that may remain
MARGIN_M = 0.5  # distance between the end of an edge and a crossing
_STEP_M = 0.2  # distance over which directions of lanes are measured


@dataclass(frozen=True)
class _CrossedLane:
    """A lane that a pedestrian crossing leads over.

    Attributes:
        lane: its number.
        at_m: position of the lane's centre line along the crossing, from the middle of the crossing.
        half_m: half of the lane's width.
        from_m, to_m: arc lengths on the lane between which the crossing lies.
        piece: the edge lane there; None inside a junction.
    """

    lane: int
    at_m: float
    half_m: float
    from_m: float
    to_m: float
    piece: Piece | None


def cut_at_crossings(
    layout: Layout, lines_m: Sequence[FloatArray], widths_m: Sequence[float], areas: Sequence[Polygon]
) -> None:
    """Cut edges at pedestrian crossings, so that each crossing lies in one junction.

    An edge is cut where a crossing leads over all its lanes. Edges of both directions without an island between them
    get a common junction. If a junction is less than ``ROOM_M`` (7.5 m) away, the edges are shortened to end before
    the crossing instead. If neither is possible, nothing is changed.

    Args:
        layout: the layout to change; its groups are final.
        lines_m: centre line (N, 2) of each lane and connector.
        widths_m: their widths.
        areas: painted areas of the crossings.
    """
    lines = [LineString(line) for line in lines_m]
    tree = shapely.STRtree(lines)
    for area in areas:
        crossed_lines = [lines[n] for n in tree.query(area, predicate="intersects").tolist()]
        band = band_of(area, crossed_lines)
        longest_m = max((line.intersection(area).length for line in crossed_lines), default=0.0)
        if band is None or 2.0 * band.half_m > LONGEST_M or longest_m > MOST_WIDTH_M / LEAST_SINE:
            continue
        lanes = _crossed_lanes(layout, band, lines, tree, widths_m)
        for carriageway in _carriageways(lanes or [], band):
            _cut_carriageway(layout, carriageway)


def _crossed_lanes(
    layout: Layout, band: Band, lines: Sequence[LineString], tree: shapely.STRtree, widths_m: Sequence[float]
) -> list[_CrossedLane] | None:
    """Return the lanes that *band*, extended at both ends, crosses, in order along it; None if one runs along it."""
    axis = band.line(REACH_M)
    strip = axis.buffer(0.5 * band.width_m + MARGIN_M, cap_style="flat")
    crossed_lanes = []
    for lane in tree.query(axis, predicate="intersects").tolist():
        direction = direction_where_met(lines[lane], axis, _STEP_M)
        if direction is None:
            return None
        if abs(float(direction[0] * band.along[1] - direction[1] * band.along[0])) < LEAST_SINE:
            return None
        meeting = lines[lane].intersection(axis)
        parts = shapely.get_parts(lines[lane].intersection(strip))
        part = min(parts, key=meeting.distance)
        first, last = sorted(lines[lane].project(Point(part.coords[end])) for end in (0, -1))
        piece = next((p for p in layout.pieces[lane] if p.from_m < last and p.to_m > first), None)
        at = float((np.asarray(meeting.coords[0]) - band.middle_m) @ band.along)
        crossed_lanes.append(_CrossedLane(lane, at, 0.5 * widths_m[lane], first, last, piece))
    return sorted(crossed_lanes, key=lambda crossed: (crossed.at_m, crossed.lane))


def _carriageways(lanes: Sequence[_CrossedLane], band: Band) -> list[list[_CrossedLane]]:
    """Return the lanes of each carriageway that *band* lies on; carriageways are divided by islands."""
    clusters: list[list[_CrossedLane]] = []
    reach_m = -np.inf
    for crossed in lanes:
        if crossed.at_m - crossed.half_m - reach_m >= NARROW_M:
            clusters.append([])
        clusters[-1].append(crossed)
        reach_m = max(reach_m, crossed.at_m + crossed.half_m)
    return [cluster for cluster in clusters if any(abs(crossed.at_m) <= band.half_m for crossed in cluster)]


def _cut_carriageway(layout: Layout, lanes: Sequence[_CrossedLane]) -> None:
    """Cut the edges of one carriageway, or end them before the crossing."""
    by_piece = {crossed.piece: crossed for crossed in lanes if crossed.piece is not None}
    groups = [group for group in layout.groups if any(piece in by_piece for piece in group)]
    if not groups or any(piece not in by_piece for group in groups for piece in group):
        return
    tight_ends = [_tight_ends(group, by_piece) for group in groups]
    if not any(tight_ends):
        if len(by_piece) == len(lanes):
            _divide(layout, groups, by_piece)
        return
    junctions = {layout.joints.find(end) for ends in tight_ends for end in ends}
    sides = [_side_at(layout, group, junctions) for group in groups]
    if None in sides or (len(junctions) > 1 and layout.between(junctions)):
        return
    if _shorten(layout, groups, [side or 0 for side in sides], by_piece):
        layout.joints.join(sorted(junctions, key=repr))


def _tight_ends(group: Sequence[Piece], by_piece: dict[Piece, _CrossedLane]) -> list[tuple[Piece, int]]:
    """Return the ends of *group* that are too close to the crossing for a car to wait between the two."""
    rooms = [min(_room_m(by_piece[piece], piece, side) for piece in group) for side in (0, 1)]
    return [(group[0], side) for side in (0, 1) if rooms[side] < ROOM_M]


def _room_m(crossed: _CrossedLane, piece: Piece, side: int) -> float:
    """Return the distance in m between the crossing and the beginning (side 0) or end (side 1) of *piece*."""
    return piece.to_m - crossed.to_m if side else crossed.from_m - piece.from_m


def _side_at(layout: Layout, group: Sequence[Piece], junctions: set[Hashable]) -> int | None:
    """Return which end of *group* (0: beginning, 1: end) lies at one of *junctions*.

    None if neither or both do, or if a lane without a link ends there (the rim of the map).
    """
    sides = [side for side in (0, 1) if layout.joints.find((group[0], side)) in junctions]
    if len(sides) != 1:
        return None
    linked = layout.has_next if sides[0] else layout.has_previous
    ends = {own[-sides[0]] for piece in group if (own := layout.pieces[piece.lane])}
    return sides[0] if all(piece not in ends or piece.lane in linked for piece in group) else None


def _shorten(
    layout: Layout, groups: Sequence[list[Piece]], sides: Sequence[int], by_piece: dict[Piece, _CrossedLane]
) -> bool:
    """Shorten each edge to end (side 1) or begin (side 0) at the crossing, if all edges stay long enough.

    Returns:
        Whether the edges were shortened.
    """
    shorter = [
        [
            piece._replace(to_m=min(piece.to_m, by_piece[piece].from_m))
            if side
            else piece._replace(from_m=max(piece.from_m, by_piece[piece].to_m))
            for piece in group
        ]
        for group, side in zip(groups, sides, strict=True)
    ]
    if any(piece.length_m < SHORTEST_M for group in shorter for piece in group):
        return False
    for group, new in zip(groups, shorter, strict=True):
        for piece, part in zip(group, new, strict=True):
            if part != piece:
                layout.replace(piece, part)
        layout.groups[layout.groups.index(group)] = new
        layout.counts["edges shortened before crossings on foot"] += 1
    return True


def _divide(layout: Layout, groups: Sequence[list[Piece]], by_piece: dict[Piece, _CrossedLane]) -> None:
    """Divide the edges at the crossing; their new ends meet in one junction."""
    ends: list[Hashable] = []
    for group in groups:
        first = [Piece(piece.lane, piece.from_m, by_piece[piece].from_m) for piece in group]
        second = [Piece(piece.lane, by_piece[piece].to_m, piece.to_m) for piece in group]
        ends += layout.part(group, first, second)
        layout.counts["edges divided at crossings on foot"] += 1
    layout.joints.join(ends)
