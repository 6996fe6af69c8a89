"""Ways that cross belong to one junction, so that one of them yields."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
import shapely

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert import polyline
from advdiff_sumo.maps.convert.absorb import absorb
from advdiff_sumo.maps.convert.layout_state import Layout
from advdiff_sumo.maps.convert.pieces import Piece

CLEARANCE_M = 1.6  # centre lines nearer than this are in each other's way
ABSORB_M = 20.0  # a lane of at most this length between two crossings may become part of one junction


def join_crossing_ways(
    layout: Layout, lines_m: Sequence[FloatArray], keep: frozenset[int] = frozenset()
) -> None:
    """Join the junctions of ways that come near each other, where no edge would begin and end in one junction.

    Short lanes between the two are put inside the joined junction; where a longer one lies between, the junctions
    stay apart and the crossing is counted. Lanes in *keep* are not put inside.
    """
    ways = inner_parts(layout)
    if len(ways) < 2:
        return
    lines = [shapely.LineString(polyline.cut(lines_m[p.lane], p.from_m, p.to_m)) for p, _ in ways]
    left, right = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=CLEARANCE_M)
    order = sorted({(int(a), int(b)) for a, b in zip(left, right, strict=True) if a < b})
    for a, b in order:
        here, there = layout.joints.find(ways[a][1]), layout.joints.find(ways[b][1])
        if here != there:
            _join(layout, {here, there}, keep)


def _join(layout: Layout, junctions: set[Hashable], keep: frozenset[int]) -> None:
    grouped = frozenset(piece for group in layout.groups if len(group) > 1 for piece in group)
    between = layout.between(junctions)
    grouped |= frozenset(piece for piece in between if piece.lane in keep)
    if between and not absorb(layout, between, ABSORB_M, grouped):
        layout.counts["crossing ways in different junctions"] += 1
        return
    layout.groups = [group for group in layout.groups if group[0] not in between]
    layout.joints.join(sorted(junctions, key=repr))
    layout.counts["junctions joined where ways cross"] += 1


def inner_parts(layout: Layout) -> list[tuple[Piece, Hashable]]:
    """Return the parts of lanes that are no edge lanes, each with an end that lies in the same junction."""
    found: list[tuple[Piece, Hashable]] = []
    for lane, length in enumerate(layout.lengths_m):
        start, mark = 0.0, (lane, "start")
        end: Hashable = mark
        for piece in layout.pieces[lane]:
            found.append((Piece(lane, start, piece.from_m), (piece, 0)))
            start, end = piece.to_m, (piece, 1)
        found.append((Piece(lane, start, length), end))
    return [(part, end) for part, end in found if part.length_m > 1e-6]


def unresolved_crossings(layout: Layout, lines_m: Sequence[FloatArray]) -> int:
    """Return how many edge lanes are crossed by a way or by another edge lane, where nobody yields."""
    edges = layout.all_pieces()
    ways = [part for part, _ in inner_parts(layout)]
    both = [shapely.LineString(polyline.cut(lines_m[p.lane], p.from_m, p.to_m)) for p in (*edges, *ways)]
    left, right = shapely.STRtree(both).query(both[: len(edges)], predicate="crosses")
    return len(np.unique(left[right > left]))
