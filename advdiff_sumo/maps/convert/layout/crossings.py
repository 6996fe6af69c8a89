"""Ways that cross belong to one junction, so that one of them yields."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.layout.absorb import absorb
from advdiff_sumo.maps.convert.layout.lane_segments import CUT_M, Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout

CLEARANCE_M = 1.6  # centre lines nearer than this are in each other's way
# A lane of at most this length between two crossings may become part of one junction; an edge of longer ones is divided
# instead, into halves of at least 10 m. With grouping.py's 25 m an edge of 20 to 25 m whose lanes may not go inside
# would be neither, and its junctions would stay apart; on the genuine maps the layouts are the same with either.
ABSORB_M = 20.0


def join_crossing_ways(
    layout: Layout, lines_m: Sequence[FloatArray], keep: frozenset[int] = frozenset()
) -> None:
    """Join the junctions of ways that come near each other, where no edge would begin and end in one junction.

    Short lanes between the two are put inside the joined junction, longer ones are divided once they are grouped;
    where neither can be, the junctions stay apart and the crossing is counted. Lanes in *keep* are not put inside.
    """
    for one, other in crossing_bonds(layout, lines_m):
        here, there = layout.joints.find(one), layout.joints.find(other)
        if here != there:
            _join(layout, {here, there}, keep)


def crossing_bonds(layout: Layout, lines_m: Sequence[FloatArray]) -> list[tuple[Hashable, Hashable]]:
    """Return pairs of ends in the junctions of ways that come near each other."""
    ways = inner_parts(layout)
    if len(ways) < 2:
        return []
    lines = [shapely.LineString(polyline.cut(lines_m[p.lane], p.from_m, p.to_m)) for p, _ in ways]
    left, right = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=CLEARANCE_M)
    order = sorted({(int(a), int(b)) for a, b in zip(left, right, strict=True) if a < b})
    return [(ways[a][1], ways[b][1]) for a, b in order]


def _join(layout: Layout, junctions: set[Hashable], keep: frozenset[int]) -> None:
    between = layout.between(junctions)
    divisible = _divisible(layout, between)
    inside = [piece for piece in between if not any(piece in group for group in divisible)]
    grouped = frozenset(piece for group in layout.groups if len(group) > 1 for piece in group)
    grouped |= frozenset(piece for piece in inside if piece.lane in keep)
    if inside and not absorb(layout, inside, ABSORB_M, grouped):
        layout.counts["crossing ways in different junctions"] += 1
        return
    layout.groups = [group for group in layout.groups if group[0] not in inside]
    for group in divisible:
        _divide(layout, group)
    layout.joints.join(sorted(junctions, key=repr))
    layout.counts["junctions joined where ways cross"] += 1


def _divisible(layout: Layout, between: Sequence[Piece]) -> list[list[Piece]]:
    """Return the edges among *between* that are long enough for a junction of their own in their middle."""
    long = [group for group in layout.groups if all(p.length_m > ABSORB_M for p in group)]
    return [group for group in long if group[0] in between]


def _divide(layout: Layout, group: list[Piece]) -> None:
    """Part an edge in its middle, so that it does not begin and end in one junction."""
    cuts = [0.5 * (piece.from_m + piece.to_m) for piece in group]
    first = [Piece(p.lane, p.from_m, cut - 0.5 * CUT_M) for p, cut in zip(group, cuts, strict=True)]
    second = [Piece(p.lane, cut + 0.5 * CUT_M, p.to_m) for p, cut in zip(group, cuts, strict=True)]
    layout.joints.join(layout.part(group, first, second))
    layout.counts["edges divided to join junctions where ways cross"] += 1


def inner_parts(layout: Layout) -> list[tuple[Piece, Hashable]]:
    """Return the parts of lanes that are no edge lanes, each with an end that lies in the same junction."""
    parts: list[tuple[Piece, Hashable]] = []
    for lane, length in enumerate(layout.lengths_m):
        start, mark = 0.0, (lane, "start")
        end: Hashable = mark
        for piece in layout.pieces[lane]:
            parts.append((Piece(lane, start, piece.from_m), (piece, 0)))
            start, end = piece.to_m, (piece, 1)
        parts.append((Piece(lane, start, length), end))
    return [(part, end) for part, end in parts if part.length_m > 1e-6]
