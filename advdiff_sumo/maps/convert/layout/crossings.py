"""Join the junctions of lanes that cross, so that vehicles on one of them yield."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.layout.absorb import absorb
from advdiff_sumo.maps.convert.layout.lane_segments import CUT_M, Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout

CLEARANCE_M = 1.6  # internal lanes whose centre lines are nearer conflict
# A lane of at most this length between two crossings may become part of one junction. An edge of longer lanes is
# divided instead, into halves of at least 10 m. With the 25 m of grouping.py, an edge of 20 to 25 m whose lanes must
# not be absorbed would allow neither. On the real maps both values give equal layouts.
ABSORB_M = 20.0


def join_crossing_lanes(
    layout: Layout, lines_m: Sequence[FloatArray], keep: frozenset[int] = frozenset()
) -> None:
    """Join the junctions of internal lanes that come close to each other.

    No edge may begin and end in the joined junction. So short lanes between the two junctions, except those in *keep*,
    are absorbed by it. Longer lanes that are already grouped are divided. If neither is possible, the junctions stay
    separate and the crossing is counted. *lines_m* are the centre lines (N, 2) of all lanes and connectors.
    """
    for first_end, second_end in crossing_ends(layout, lines_m):
        first, second = layout.joints.find(first_end), layout.joints.find(second_end)
        if first != second:
            _join_junctions(layout, {first, second}, keep)


def crossing_ends(layout: Layout, lines_m: Sequence[FloatArray]) -> list[tuple[Hashable, Hashable]]:
    """Return a pair of lane ends, one of each junction, for each two internal lanes that come close to each other."""
    parts = internal_parts(layout)
    if len(parts) < 2:
        return []
    lines = [shapely.LineString(polyline.cut(lines_m[p.lane], p.from_m, p.to_m)) for p, _ in parts]
    first, second = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=CLEARANCE_M)
    pairs = sorted({(int(a), int(b)) for a, b in zip(first, second, strict=True) if a < b})
    return [(parts[a][1], parts[b][1]) for a, b in pairs]


def _join_junctions(layout: Layout, junctions: set[Hashable], keep: frozenset[int]) -> None:
    """Join *junctions* if the edge lanes between them can be absorbed or divided; else count the crossing."""
    between = layout.between(junctions)
    divisible = _divisible(layout, between)
    to_absorb = [piece for piece in between if not any(piece in group for group in divisible)]
    grouped = frozenset(piece for group in layout.groups if len(group) > 1 for piece in group)
    grouped |= frozenset(piece for piece in to_absorb if piece.lane in keep)
    if to_absorb and not absorb(layout, to_absorb, ABSORB_M, grouped):
        layout.counts["crossing ways in different junctions"] += 1
        return
    layout.groups = [group for group in layout.groups if group[0] not in to_absorb]
    for group in divisible:
        _divide(layout, group)
    layout.joints.join(sorted(junctions, key=repr))
    layout.counts["junctions joined where ways cross"] += 1


def _divisible(layout: Layout, between: Sequence[Piece]) -> list[list[Piece]]:
    """Return the edges among *between* that are long enough for a junction in their middle."""
    long = [group for group in layout.groups if all(p.length_m > ABSORB_M for p in group)]
    return [group for group in long if group[0] in between]


def _divide(layout: Layout, group: list[Piece]) -> None:
    """Divide an edge in its middle, so that it does not begin and end in one junction."""
    cuts = [0.5 * (piece.from_m + piece.to_m) for piece in group]
    first = [Piece(p.lane, p.from_m, cut - 0.5 * CUT_M) for p, cut in zip(group, cuts, strict=True)]
    second = [Piece(p.lane, cut + 0.5 * CUT_M, p.to_m) for p, cut in zip(group, cuts, strict=True)]
    layout.joints.join(layout.part(group, first, second))
    layout.counts["edges divided to join junctions where ways cross"] += 1


def internal_parts(layout: Layout) -> list[tuple[Piece, Hashable]]:
    """Return the parts of lanes that are not edge lanes, each with a lane end in the same junction."""
    parts: list[tuple[Piece, Hashable]] = []
    for lane, length in enumerate(layout.lengths_m):
        start = 0.0
        end: Hashable = (lane, "start")
        for piece in layout.pieces[lane]:
            parts.append((Piece(lane, start, piece.from_m), (piece, 0)))
            start, end = piece.to_m, (piece, 1)
        parts.append((Piece(lane, start, length), end))
    return [(part, end) for part, end in parts if part.length_m > 1e-6]
