"""Edges make way for crossings on foot, which SUMO has in junctions alone: a crossing in mid-block gets a junction."""

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
)

SHORTEST_M = 5.0  # what is left of an edge
MARGIN_M = 0.5  # between the end of an edge and a crossing


@dataclass(frozen=True)
class _Hit:
    """A lane that a crossing leads over.

    Attributes:
        lane: its number.
        at_m: where along the crossing, from its middle.
        half_m: half of the lane's width.
        from_m, to_m: what the crossing takes of the lane.
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
    """Cut edges where *areas* lie across all their lanes, so that a crossing leads over ways of one junction.

    Edges of both directions without an island between them get one junction. Within 7.5 m of a junction they end
    before the crossing instead. Where neither can be, nothing is changed.

    Args:
        layout: the groups of which are final.
        lines_m: centre line (N, 2) of each lane and connector.
        widths_m: their widths.
        areas: crossings as painted.
    """
    lines = [LineString(line) for line in lines_m]
    tree = shapely.STRtree(lines)
    for area in areas:
        across = [lines[n] for n in tree.query(area, predicate="intersects").tolist()]
        band = band_of(area, across)
        along_m = max((line.intersection(area).length for line in across), default=0.0)
        if band is None or 2.0 * band.half_m > LONGEST_M or along_m > MOST_WIDTH_M / LEAST_SINE:
            continue
        hits = _hits(layout, band, lines, tree, widths_m)
        for cluster in _carriageways(hits or [], band):
            _cut(layout, cluster)


def _hits(
    layout: Layout, band: Band, lines: Sequence[LineString], tree: shapely.STRtree, widths_m: Sequence[float]
) -> list[_Hit] | None:
    """Return the lanes under *band* and beyond its ends, in order along it; None where one runs along it."""
    middle = band.line(REACH_M)
    strip = middle.buffer(0.5 * band.width_m + MARGIN_M, cap_style="flat")
    hits = []
    for lane in tree.query(middle, predicate="intersects").tolist():
        meeting = lines[lane].intersection(middle)
        if not isinstance(meeting, Point):
            return None
        s = lines[lane].project(meeting)
        ahead, back = (np.asarray(lines[lane].interpolate(s + step).coords[0]) for step in (0.2, -0.2))
        step = (ahead - back) / max(float(np.hypot(*(ahead - back))), 1e-9)
        if abs(float(step[0] * band.along[1] - step[1] * band.along[0])) < LEAST_SINE:
            return None
        under = lines[lane].intersection(strip)
        part = min(shapely.get_parts(under), key=meeting.distance)
        first, last = sorted(lines[lane].project(Point(part.coords[end])) for end in (0, -1))
        piece = next((p for p in layout.pieces[lane] if p.from_m < last and p.to_m > first), None)
        at = float((np.asarray(meeting.coords[0]) - band.middle_m) @ band.along)
        hits.append(_Hit(lane, at, 0.5 * widths_m[lane], first, last, piece))
    return sorted(hits, key=lambda hit: (hit.at_m, hit.lane))


def _carriageways(hits: Sequence[_Hit], band: Band) -> list[list[_Hit]]:
    """Return the lanes of each carriageway that is painted; islands are between."""
    clusters: list[list[_Hit]] = []
    reach_m = -np.inf
    for hit in hits:
        if hit.at_m - hit.half_m - reach_m >= NARROW_M:
            clusters.append([])
        clusters[-1].append(hit)
        reach_m = max(reach_m, hit.at_m + hit.half_m)
    return [cluster for cluster in clusters if any(abs(hit.at_m) <= band.half_m for hit in cluster)]


def _cut(layout: Layout, hits: Sequence[_Hit]) -> None:
    """Cut the edges of one carriageway, or end them before the crossing."""
    by_piece = {hit.piece: hit for hit in hits if hit.piece is not None}
    groups = [group for group in layout.groups if any(piece in by_piece for piece in group)]
    if not groups or any(piece not in by_piece for group in groups for piece in group):
        return
    near = [_ends_near(group, by_piece) for group in groups]
    if not any(near):
        if len(by_piece) == len(hits):
            _divide(layout, groups, by_piece)
        return
    junctions = {layout.joints.find(end) for ends in near for end in ends}
    sides = [_side_at(layout, group, junctions) for group in groups]
    if None in sides or (len(junctions) > 1 and layout.between(junctions)):
        return
    if _shorten(layout, groups, [side or 0 for side in sides], by_piece):
        layout.joints.join(sorted(junctions, key=repr))


def _ends_near(group: Sequence[Piece], hits: dict[Piece, _Hit]) -> list[tuple[Piece, int]]:
    """Return the ends of *group* between which and the crossing no car has room."""
    rooms = [min(_room(hits[piece], piece, side) for piece in group) for side in (0, 1)]
    return [(group[0], side) for side in (0, 1) if rooms[side] < ROOM_M]


def _room(hit: _Hit, piece: Piece, side: int) -> float:
    """Return the metres between the crossing and the beginning (side 0) or end (side 1) of *piece*."""
    return piece.to_m - hit.to_m if side else hit.from_m - piece.from_m


def _side_at(layout: Layout, group: Sequence[Piece], junctions: set[Hashable]) -> int | None:
    """Return with which end *group* lies at one of *junctions*; None with neither or both, and at the map's rim."""
    followed, entered = {a for a, _ in layout.links}, {b for _, b in layout.links}
    sides = [side for side in (0, 1) if layout.joints.find((group[0], side)) in junctions]
    if len(sides) != 1:
        return None
    linked = followed if sides[0] else entered
    ends = {own[-sides[0]] for piece in group if (own := layout.pieces[piece.lane])}
    return sides[0] if all(piece not in ends or piece.lane in linked for piece in group) else None


def _shorten(
    layout: Layout, groups: Sequence[list[Piece]], sides: Sequence[int], hits: dict[Piece, _Hit]
) -> bool:
    """End (side 1) or begin (side 0) each edge at the crossing, if enough of all is left; return whether it is."""
    shorter = [
        [
            piece._replace(to_m=min(piece.to_m, hits[piece].from_m))
            if side
            else piece._replace(from_m=max(piece.from_m, hits[piece].to_m))
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


def _divide(layout: Layout, groups: Sequence[list[Piece]], hits: dict[Piece, _Hit]) -> None:
    """Part the edges at the crossing; their new ends meet in one junction."""
    ends: list[Hashable] = []
    for group in groups:
        first = [Piece(piece.lane, piece.from_m, hits[piece].from_m) for piece in group]
        second = [Piece(piece.lane, hits[piece].to_m, piece.to_m) for piece in group]
        ends += layout.part(group, first, second)
        layout.counts["edges divided at crossings on foot"] += 1
    layout.joints.join(ends)
