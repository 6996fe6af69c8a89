"""Find the connections of a layout: paths from the end of one piece to the beginning of the next."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from advdiff_sumo.maps.convert.layout.lane_segments import Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout


@dataclass(frozen=True)
class LaneConnection:
    """A path through a junction.

    Attributes:
        origin: piece at whose end it begins.
        target: piece at whose beginning it ends.
        parts: consecutive parts of lanes that it consists of; parts without length are left out.
    """

    origin: Piece
    target: Piece
    parts: tuple[Piece, ...]

    @property
    def length_m(self) -> float:
        """Length in m."""
        return sum(part.length_m for part in self.parts)

    @property
    def lanes(self) -> tuple[int, ...]:
        """Lanes in order from the origin's to the target's, each once."""
        lanes = (self.origin.lane, *(part.lane for part in self.parts), self.target.lane)
        return tuple(dict.fromkeys(lanes))


def find_connections(layout: Layout) -> tuple[list[LaneConnection], list[LaneConnection]]:
    """Return (connections, duplicates), both ordered by origin.

    SUMO holds one connection between two lanes. Of several, the shortest is kept; the others are *duplicates*.
    """
    following: dict[int, list[int]] = defaultdict(list)
    for a, b in layout.links:
        following[a].append(b)
    shortest: dict[tuple[Piece, Piece], LaneConnection] = {}
    duplicates = []
    for piece in layout.all_pieces():
        for connection in _connections_from(layout, following, piece):
            key = (connection.origin, connection.target)
            if key not in shortest:
                shortest[key] = connection
            elif connection.length_m < shortest[key].length_m:
                duplicates.append(shortest[key])
                shortest[key] = connection
            else:
                duplicates.append(connection)
    return list(shortest.values()), duplicates


def _connections_from(layout: Layout, following: dict[int, list[int]], piece: Piece) -> list[LaneConnection]:
    """Return every connection from the end of *piece* to the next pieces."""
    lane_pieces = layout.pieces[piece.lane]
    index = lane_pieces.index(piece)
    if index + 1 < len(lane_pieces):
        next_piece = lane_pieces[index + 1]
        return [LaneConnection(piece, next_piece, (Piece(piece.lane, piece.to_m, next_piece.from_m),))]
    tail = _part(piece.lane, piece.to_m, layout.lengths_m[piece.lane])
    connections: list[LaneConnection] = []
    stack: list[tuple[int, tuple[Piece, ...], frozenset[int]]] = [
        (lane, tail, frozenset((piece.lane,))) for lane in reversed(following[piece.lane])
    ]
    while stack:
        lane, parts, visited = stack.pop()
        if layout.pieces[lane]:
            first = layout.pieces[lane][0]
            connections.append(LaneConnection(piece, first, parts + _part(lane, 0.0, first.from_m)))
        elif lane not in visited:
            through = parts + _part(lane, 0.0, layout.lengths_m[lane])
            stack += [(next_lane, through, visited | {lane}) for next_lane in reversed(following[lane])]
    return connections


def _part(lane: int, from_m: float, to_m: float) -> tuple[Piece, ...]:
    return (Piece(lane, from_m, to_m),) if to_m > from_m else ()
