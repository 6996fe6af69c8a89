"""Put short pieces inside a junction where they stand in the way of one."""

from __future__ import annotations

from collections.abc import Sequence

from advdiff_sumo.maps.convert.layout.lane_paths import find_connections
from advdiff_sumo.maps.convert.layout.lane_segments import Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout


def absorb(layout: Layout, pieces: Sequence[Piece], longest_m: float, grouped: frozenset[Piece]) -> bool:
    """Make *pieces* parts of internal lanes, or return False and change nothing.

    Refused for pieces that are too long, that share an edge with others, that end at the rim of the map, or where
    two ways between the same two lanes would come of it, of which SUMO holds only one.
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
    own = layout.pieces[piece.lane]
    first = own[0] == piece and not any(b == piece.lane for _, b in layout.links)
    last = own[-1] == piece and not any(a == piece.lane for a, _ in layout.links)
    return first or last
