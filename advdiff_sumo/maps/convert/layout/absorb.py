"""Turn short edge lanes into internal lanes of a junction, if the layout needs it."""

from __future__ import annotations

from collections.abc import Sequence

from advdiff_sumo.maps.convert.layout.lane_paths import find_connections
from advdiff_sumo.maps.convert.layout.lane_segments import Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout


def absorb(layout: Layout, pieces: Sequence[Piece], longest_m: float, grouped: frozenset[Piece]) -> bool:
    """Turn *pieces* into parts of internal lanes and return True, or change nothing and return False.

    Nothing is changed if a piece is longer than *longest_m*, is *grouped* in an edge with others, or ends at the rim of
    the map, or if there would be two connections between the same two lanes, of which SUMO holds only one.
    """
    if any(p.length_m > longest_m or p in grouped or _at_rim(layout, p) for p in pieces):
        return False
    before = len(find_connections(layout)[1])
    kept = {piece.lane: list(layout.pieces[piece.lane]) for piece in pieces}
    for piece in pieces:
        layout.pieces[piece.lane].remove(piece)
    if len(find_connections(layout)[1]) > before:
        layout.pieces.update(kept)
        return False
    for piece in pieces:
        layout.joints.join(((piece, 0), (piece, 1)))
    layout.counts["pieces put inside a junction"] += len(pieces)
    return True


def _at_rim(layout: Layout, piece: Piece) -> bool:
    """Return whether *piece* begins a lane without predecessor or ends a lane without successor."""
    lane_pieces = layout.pieces[piece.lane]
    begins = lane_pieces[0] == piece and piece.lane not in layout.has_previous
    ends = lane_pieces[-1] == piece and piece.lane not in layout.has_next
    return begins or ends
