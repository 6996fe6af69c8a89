"""Connections of a layout: the ways from the end of one piece to the beginning of the next."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from advdiff_sumo.maps.convert.layout.lane_segments import Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout


@dataclass(frozen=True)
class LaneConnection:
    """A way through a junction.

    Attributes:
        origin: piece that it leaves at its end.
        target: piece that it enters at its beginning.
        parts: consecutive parts of lanes that it runs on; parts without length are left out.
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
        whole = (self.origin.lane, *(part.lane for part in self.parts), self.target.lane)
        return tuple(dict.fromkeys(whole))


def find_connections(layout: Layout) -> tuple[list[LaneConnection], list[LaneConnection]]:
    """Return (connections, doubles), both ordered by origin.

    SUMO holds one connection between two lanes; of several ways the shortest is kept, the others are *doubles*.
    """
    following: dict[int, list[int]] = defaultdict(list)
    for a, b in layout.links:
        following[a].append(b)
    best: dict[tuple[Piece, Piece], LaneConnection] = {}
    doubles = []
    for piece in layout.all_pieces():
        for way in _ways(layout, following, piece):
            key = (way.origin, way.target)
            if key not in best:
                best[key] = way
            elif way.length_m < best[key].length_m:
                doubles.append(best[key])
                best[key] = way
            else:
                doubles.append(way)
    return list(best.values()), doubles


def _ways(layout: Layout, following: dict[int, list[int]], piece: Piece) -> list[LaneConnection]:
    """Return every way from the end of *piece* to the next pieces."""
    own = layout.pieces[piece.lane]
    index = own.index(piece)
    if index + 1 < len(own):
        after = own[index + 1]
        return [LaneConnection(piece, after, (Piece(piece.lane, piece.to_m, after.from_m),))]
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
            stack += [(after, through, visited | {lane}) for after in reversed(following[lane])]
    return connections


def _part(lane: int, from_m: float, to_m: float) -> tuple[Piece, ...]:
    return (Piece(lane, from_m, to_m),) if to_m > from_m else ()
