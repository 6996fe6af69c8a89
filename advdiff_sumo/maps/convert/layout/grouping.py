"""Group pieces of neighbouring lanes into edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from advdiff_sumo.maps.convert.layout.absorb import absorb
from advdiff_sumo.maps.convert.layout.lane_segments import CUT_M, UNEVEN_M, Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout
from advdiff_sumo.maps.convert.layout.neighbours import SideBySide

KEEP_SHARE = 0.2  # smallest share of the longer piece over which two pieces of an edge run side by side
# A piece of at most this length may be absorbed by a junction to let two lanes share an edge. It is longer than in
# crossings.py: no edge is divided here, so a piece that stays separates two lanes (20 m separate one more pair in
# singapore-onenorth).
ABSORB_M = 25.0


@dataclass(frozen=True)
class _Match:
    """A pair of pieces that could share an edge, *left* beside *right*."""

    left: Piece
    right: Piece
    overlap_m: float


def group_pieces(layout: Layout, pairs: Sequence[SideBySide]) -> list[list[Piece]]:
    """Return the pieces of each edge, right to left; pieces share an edge unless an edge would become a loop.

    A loop is an edge that begins and ends in one junction.
    """
    left_of: dict[Piece, Piece] = {}
    right_of: dict[Piece, Piece] = {}
    for match in _matches(layout, pairs):
        if (
            match.left not in layout.pieces[match.left.lane]
            or match.right not in layout.pieces[match.right.lane]
        ):
            continue
        if match.right in left_of or match.left in right_of:
            layout.counts["neighbours with another neighbour already"] += 1
        elif _make_room(layout, match, frozenset((*left_of, *right_of, match.left, match.right))):
            left_of[match.right], right_of[match.left] = match.left, match.right
            for side in (0, 1):
                layout.joints.join(((match.left, side), (match.right, side)))
        else:
            layout.counts["neighbours kept apart by junctions"] += 1
    return [_chain(piece, left_of) for piece in layout.all_pieces() if piece not in right_of]


def _matches(layout: Layout, pairs: Sequence[SideBySide]) -> list[_Match]:
    """Return the pairs of pieces side by side whose ends differ little, longest overlap first."""
    matches = []
    for pair in pairs:
        for left in layout.pieces[pair.left]:
            start, end = pair.across(pair.left, left.from_m), pair.across(pair.left, left.to_m)
            for right in layout.pieces[pair.right]:
                overlap = min(end, right.to_m) - max(start, right.from_m)
                uneven = max(abs(start - right.from_m), abs(end - right.to_m))
                shorter, longer = sorted((right.length_m, end - start))
                overlaps = overlap >= 0.3 * shorter and overlap >= KEEP_SHARE * longer
                if overlaps and uneven <= UNEVEN_M + 2 * CUT_M:
                    matches.append(_Match(left, right, overlap))
    return sorted(matches, key=lambda m: (-m.overlap_m, m.left, m.right))


def _make_room(layout: Layout, match: _Match, grouped: frozenset[Piece]) -> bool:
    """Return whether two pieces can share an edge; short pieces that would become loops are absorbed by a junction."""
    (left_start, left_end), (right_start, right_end) = (
        layout.junctions(match.left),
        layout.junctions(match.right),
    )
    starts, ends = {left_start, right_start}, {left_end, right_end}
    if starts & ends:
        return False
    between = layout.between(starts) + layout.between(ends)
    return not between or absorb(layout, between, ABSORB_M, grouped)


def _chain(piece: Piece, left_of: dict[Piece, Piece]) -> list[Piece]:
    """Return *piece* and all pieces on its left, right to left."""
    chain = [piece]
    while chain[-1] in left_of:
        chain.append(left_of[chain[-1]])
    return chain
