"""Turn parts of connectors into edges, so that no edge lane begins and ends in the same junction."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TypeAlias

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.crossings import crossing_ends
from advdiff_sumo.maps.convert.layout.joints import Joints
from advdiff_sumo.maps.convert.layout.lane_paths import find_connections
from advdiff_sumo.maps.convert.layout.lane_segments import ROOM_M, Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout, joints_of, linked_ends

PROMOTE_M = 4.0  # shortest connector that may become an edge
EndPairs: TypeAlias = Sequence[tuple[Hashable, Hashable]]  # pairs of lane ends in one junction


def divide_double_connections(layout: Layout, clear: Mapping[int, Piece]) -> None:
    """Turn part of a connector into an edge for each second connection between two lanes.

    SUMO holds only one connection between two lanes. If the junction cannot be divided for the new edge,
    :func:`remove_loops` removes the edge again.

    Args:
        layout: the layout to change.
        clear: the stretch of each connector that may become an edge.
    """
    connections, duplicates = find_connections(layout)
    kept = {(connection.origin, connection.target): set(connection.lanes) for connection in connections}
    for duplicate in duplicates:
        if (
            _promote(layout, set(duplicate.lanes) - kept[duplicate.origin, duplicate.target], clear)
            is not None
        ):
            layout.counts["connectors made edges as a second way between two lanes"] += 1


def remove_loops(layout: Layout, clear: Mapping[int, Piece]) -> None:
    """Change the layout until no piece begins and ends in the same junction.

    If connectors bypass a lane, both ends of the lane belong to one junction. Then a part of a connector on the
    shortest bypass becomes an edge. If no connector is suitable, the lane is absorbed by the junction.
    """
    while looped := _loop_pieces(layout, joints_of(layout)):
        if _promote(layout, _bypass(layout, looped[0], ()), clear) is not None:
            layout.counts["connectors made edges to part junctions"] += 1
        else:
            layout.pieces[looped[0].lane].remove(looped[0])
            layout.counts["pieces put inside a junction"] += 1


def divide_at_crossings(layout: Layout, clear: Mapping[int, Piece], lines_m: Sequence[FloatArray]) -> None:
    """Turn parts of connectors into edges where joining the junctions of crossing lanes would create a loop.

    A loop is a lane that begins and ends in one junction. New edges that end up as loops themselves are removed again.
    Lanes for which no connector is suitable stay unchanged.
    """
    long_enough = {lane: edge for lane, edge in clear.items() if edge.length_m >= ROOM_M}
    promoted: list[Piece] = []
    while True:
        extra_pairs = crossing_ends(layout, lines_m)
        looped = _loop_pieces(layout, joints_of(layout, extra_pairs))
        for piece in looped:
            edge = _promote(layout, _bypass(layout, piece, extra_pairs), long_enough)
            if edge is not None:
                promoted.append(edge)
                break
        else:
            break
    for edge in set(promoted) & set(looped):
        layout.pieces[edge.lane].remove(edge)
    layout.counts["connectors made edges to part junctions"] += len(set(promoted) - set(looped))


def _loop_pieces(layout: Layout, joints: Joints) -> list[Piece]:
    """Return the pieces that begin and end in one junction, longest first."""
    looped = [piece for piece in layout.all_pieces() if joints.find((piece, 0)) == joints.find((piece, 1))]
    return sorted(looped, key=lambda piece: (-piece.length_m, piece))


def _promote(layout: Layout, lanes: Iterable[int], clear: Mapping[int, Piece]) -> Piece | None:
    """Turn the longest clear stretch of a connector among *lanes* into an edge lane; return it (None if none fits)."""
    candidates = [
        lane
        for lane in lanes
        if lane in clear and not layout.pieces[lane] and layout.lengths_m[lane] >= PROMOTE_M
    ]
    if not candidates:
        return None
    chosen = max(candidates, key=lambda lane: (clear[lane].length_m, layout.lengths_m[lane], -lane))
    layout.pieces[chosen] = [clear[chosen]]
    return clear[chosen]


def _bypass(layout: Layout, piece: Piece, extra_pairs: EndPairs) -> list[int]:
    """Return the lanes without pieces on the shortest chain of joined lane ends from one end of *piece* to the other.

    *extra_pairs* of lane ends are joined in addition to those of *layout*.
    """
    joined: dict[Hashable, list[Hashable]] = defaultdict(list)
    for a, b in (*linked_ends(layout), *extra_pairs):
        joined[a].append(b)
        joined[b].append(a)
    origin: dict[Hashable, Hashable] = {(piece, 0): (piece, 0)}
    queue: deque[Hashable] = deque([(piece, 0)])
    while queue and (piece, 1) not in origin:
        end = queue.popleft()
        for other_end in joined[end]:
            if other_end not in origin:
                origin[other_end] = end
                queue.append(other_end)
    lanes, end = [], (piece, 1)
    while origin[end] != end:
        end = origin[end]
        if isinstance(end, tuple) and isinstance(end[0], int) and not layout.pieces[end[0]]:
            lanes.append(end[0])
    return list(dict.fromkeys(lanes))
