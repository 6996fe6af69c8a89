"""Edges in the middle of connectors, where otherwise a lane would begin and end in one junction."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TypeAlias

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.crossings import crossing_bonds
from advdiff_sumo.maps.convert.layout.joints import Joints
from advdiff_sumo.maps.convert.layout.lane_paths import find_connections
from advdiff_sumo.maps.convert.layout.lane_segments import ROOM_M, Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout, bonds_of, joints_of

PROMOTE_M = 4.0  # a connector at least this long may become an edge of its own
Bonds: TypeAlias = Sequence[tuple[Hashable, Hashable]]


def part_second_ways(layout: Layout, clear: Mapping[int, Piece]) -> None:
    """Give a connector of each second way between two lanes an edge, as SUMO holds one way between two lanes.

    The edge stays where the junction can be parted for it; see :func:`break_loops`.

    Args:
        layout: what is being built.
        clear: the place for an edge on each connector.
    """
    ways, doubles = find_connections(layout)
    kept = {(way.origin, way.target): set(way.lanes) for way in ways}
    for double in doubles:
        if _promote(layout, set(double.lanes) - kept[double.origin, double.target], clear) is not None:
            layout.counts["connectors made edges as a second way between two lanes"] += 1


def break_loops(layout: Layout, clear: Mapping[int, Piece]) -> None:
    """Make sure that no piece begins and ends in one junction.

    Where a connector bypasses a lane, the ends of that lane would fall into one junction; a connector on the
    shortest way round becomes an edge of its own. A lane without such a way is put inside the junction.
    """
    while looped := _looped(layout, joints_of(layout)):
        if _promote(layout, _way_round(layout, looped[0], ()), clear) is not None:
            layout.counts["connectors made edges to part junctions"] += 1
        else:
            layout.pieces[looped[0].lane].remove(looped[0])
            layout.counts["pieces put inside a junction"] += 1


def part_crossings(layout: Layout, clear: Mapping[int, Piece], lines_m: Sequence[FloatArray]) -> None:
    """Do the same for lanes whose ends would fall into one junction because ways that cross belong to one.

    Lanes for which that does not help stay as they are.
    """
    roomy = {lane: edge for lane, edge in clear.items() if edge.length_m >= ROOM_M}
    promoted: list[Piece] = []
    while True:
        bonds = crossing_bonds(layout, lines_m)
        looped = _looped(layout, joints_of(layout, bonds))
        for piece in looped:
            edge = _promote(layout, _way_round(layout, piece, bonds), roomy)
            if edge is not None:
                promoted.append(edge)
                break
        else:
            break
    for edge in set(promoted) & set(looped):
        layout.pieces[edge.lane].remove(edge)
    layout.counts["connectors made edges to part junctions"] += len(set(promoted) - set(looped))


def _looped(layout: Layout, joints: Joints) -> list[Piece]:
    """Return the pieces that begin and end in one junction, the longest first."""
    looped = [piece for piece in layout.all_pieces() if joints.find((piece, 0)) == joints.find((piece, 1))]
    return sorted(looped, key=lambda piece: (-piece.length_m, piece))


def _promote(layout: Layout, lanes: Iterable[int], clear: Mapping[int, Piece]) -> Piece | None:
    """Make a part of one connector among *lanes* an edge, of the one that is out of others' way for longest."""
    fit = [
        lane
        for lane in lanes
        if lane in clear and not layout.pieces[lane] and layout.lengths_m[lane] >= PROMOTE_M
    ]
    if not fit:
        return None
    best = max(fit, key=lambda lane: (clear[lane].length_m, layout.lengths_m[lane], -lane))
    layout.pieces[best] = [clear[best]]
    return clear[best]


def _way_round(layout: Layout, piece: Piece, more: Bonds) -> list[int]:
    """Return the lanes without pieces on the shortest chain that joins the two ends of *piece*; *more* join too."""
    beside: dict[Hashable, list[Hashable]] = defaultdict(list)
    for a, b in (*bonds_of(layout), *more):
        beside[a].append(b)
        beside[b].append(a)
    origin: dict[Hashable, Hashable] = {(piece, 0): (piece, 0)}
    queue: deque[Hashable] = deque([(piece, 0)])
    while queue and (piece, 1) not in origin:
        here = queue.popleft()
        for there in beside[here]:
            if there not in origin:
                origin[there] = here
                queue.append(there)
    way, here = [], (piece, 1)
    while origin[here] != here:
        here = origin[here]
        if isinstance(here, tuple) and isinstance(here[0], int) and not layout.pieces[here[0]]:
            way.append(here[0])
    return list(dict.fromkeys(way))
