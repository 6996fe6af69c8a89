"""Divide lanes into edges and junctions: which pieces share an edge, and which lane ends share a junction."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert.layout.clear_stretches import STUB_M, clear_stretches
from advdiff_sumo.maps.convert.layout.connector_edges import (
    divide_at_crossings,
    divide_double_connections,
    remove_loops,
)
from advdiff_sumo.maps.convert.layout.crossings import join_crossing_lanes
from advdiff_sumo.maps.convert.layout.grouping import KEEP_SHARE, group_pieces
from advdiff_sumo.maps.convert.layout.lane_segments import CUT_M, Piece, cut_lanes
from advdiff_sumo.maps.convert.layout.layout_state import Layout, joints_of
from advdiff_sumo.maps.convert.layout.neighbours import SideBySide

SHORTEST_EDGE_M = 1.0  # shortest edge: netconvert moves the ends of shorter ones


def lay_out(
    lines_m: Sequence[FloatArray],
    is_connector: Sequence[bool],
    links: Sequence[tuple[int, int]],
    pairs: Sequence[SideBySide],
) -> Layout:
    """Return the layout of a map.

    Args:
        lines_m: centre line (N, 2) of each lane and connector.
        is_connector: whether each of them is a connector, which becomes an internal lane if possible.
        links: ordered pairs (from, to) of lane numbers.
        pairs: lanes that run side by side.
    """
    road_pairs = [pair for pair in pairs if not (is_connector[pair.left] or is_connector[pair.right])]
    lengths = [line_length_m(line) for line in lines_m]
    cut = cut_lanes(lengths, road_pairs)
    pieces = {lane: ([] if is_connector[lane] else cut[lane]) for lane in range(len(lengths))}
    layout = Layout(lengths, list(links), pieces)
    layout.counts["lanes cut"] = sum(len(lane_pieces) > 1 for lane_pieces in pieces.values())
    _add_rim_edges(layout, is_connector)
    _make_room_for_direct_links(layout, is_connector)
    clear = clear_stretches(lines_m, is_connector)
    divide_double_connections(layout, clear)
    remove_loops(layout, clear)
    divide_at_crossings(layout, clear, lines_m)
    layout.joints = joints_of(layout)
    lanes_with_neighbour = frozenset(lane for pair in road_pairs for lane in (pair.left, pair.right))
    join_crossing_lanes(layout, lines_m, lanes_with_neighbour)
    layout.groups = group_pieces(layout, road_pairs)
    _even_out(layout, road_pairs)
    join_crossing_lanes(layout, lines_m)
    return layout


def _add_rim_edges(layout: Layout, is_connector: Sequence[bool]) -> None:
    """Add an edge at the open end of each connector without predecessor or successor (at the rim of the map)."""
    has_next, has_previous = layout.has_next, layout.has_previous
    for lane, length in enumerate(layout.lengths_m):
        if not is_connector[lane] or (lane in has_next and lane in has_previous):
            continue
        stub = min(STUB_M, 0.5 * length)
        start = length - stub if lane in has_previous else 0.0
        end = stub if lane in has_next else length
        layout.pieces[lane] = [Piece(lane, start, end)]
        layout.counts["connectors that end at the rim"] += 1


def _make_room_for_direct_links(layout: Layout, is_connector: Sequence[bool]) -> None:
    """Shorten lanes that follow each other without a connector, to make room for an internal lane."""
    ends_to_cut: dict[int, set[int]] = defaultdict(set)
    for a, b in layout.links:
        if layout.pieces[a] and layout.pieces[b] and not (is_connector[a] or is_connector[b]):
            ends_to_cut[a].add(-1)
            ends_to_cut[b].add(0)
    for lane, ends in sorted(ends_to_cut.items()):
        for end in sorted(ends):
            piece = layout.pieces[lane][end]
            cut = min(0.5 * CUT_M, 0.2 * piece.length_m)
            shorter = (piece.from_m + cut, piece.to_m) if end == 0 else (piece.from_m, piece.to_m - cut)
            layout.pieces[lane][end] = Piece(lane, *shorter)


def _even_out(layout: Layout, pairs: Sequence[SideBySide]) -> None:
    """Shorten the lanes of each edge to begin and end side by side; what is cut off belongs to the junctions."""
    pair_of = {(pair.right, pair.left): pair for pair in pairs}
    has_next, has_previous = layout.has_next, layout.has_previous
    for number, group in enumerate(layout.groups):
        starts, ends = _offsets(group, pair_of, 0), _offsets(group, pair_of, 1)
        shorter = []
        for piece, start, end in zip(group, starts, ends, strict=True):
            new = _shortened(piece, max(starts) - start, end - min(ends))
            new = _keep_open_end(layout, piece, new, 0) if piece.lane not in has_previous else new
            new = _keep_open_end(layout, piece, new, 1) if piece.lane not in has_next else new
            layout.counts["lane ends shortened to even an edge"] += (new.from_m > piece.from_m) + (
                new.to_m < piece.to_m
            )
            shorter.append(new)
            layout.replace(piece, new)
        layout.groups[number] = shorter
    layout.groups += _single_groups(layout)


def _keep_open_end(layout: Layout, piece: Piece, new: Piece, side: int) -> Piece:
    """Keep what shortening would cut off at the rim of the map; return the piece that replaces *piece*.

    A part that is cut off there belongs to no connection. If it is long enough, it becomes a piece of its own, which is
    added to *layout*. Otherwise the end is not shortened.

    Args:
        layout: the layout to change.
        piece: the piece before shortening.
        new: the piece after shortening.
        side: the open end, 0 for the beginning of the lane and 1 for its end.
    """
    lane_pieces = layout.pieces[piece.lane]
    cut_off = new.from_m - piece.from_m if side == 0 else piece.to_m - new.to_m
    if cut_off <= 0.0 or lane_pieces[-side] != piece:
        return new
    if cut_off < CUT_M + SHORTEST_EDGE_M:
        return new._replace(from_m=piece.from_m) if side == 0 else new._replace(to_m=piece.to_m)
    if side == 0:
        open_end = Piece(piece.lane, piece.from_m, new.from_m - CUT_M)
    else:
        open_end = Piece(piece.lane, new.to_m + CUT_M, piece.to_m)
    lane_pieces.insert(0 if side == 0 else len(lane_pieces), open_end)
    layout.joints.join(((piece, side), (open_end, 1 - side)))
    layout.counts["open ends cut off to even an edge"] += 1
    return new


def _single_groups(layout: Layout) -> list[list[Piece]]:
    """Return the pieces without a group, each as a group of its own."""
    grouped = {piece for group in layout.groups for piece in group}
    return [[piece] for piece in layout.all_pieces() if piece not in grouped]


def _offsets(group: list[Piece], pair_of: dict[tuple[int, int], SideBySide], side: int) -> list[float]:
    """Return where each piece begins (side 0) or ends (side 1), as arc length along the rightmost lane."""
    offsets = []
    for index, piece in enumerate(group):
        s = piece.to_m if side else piece.from_m
        for right, left in zip(group[index - 1 :: -1] if index else [], group[index:0:-1], strict=True):
            s = pair_of[(right.lane, left.lane)].across(left.lane, s)
        offsets.append(s)
    return offsets


def _shortened(piece: Piece, at_start_m: float, at_end_m: float) -> Piece:
    """Return *piece* shortened at both ends, by proportionally less where it would become too short."""
    cut = at_start_m + at_end_m
    most_cut = min((1.0 - KEEP_SHARE) * piece.length_m, piece.length_m - SHORTEST_EDGE_M)
    if cut <= 0.0:
        return piece
    share = 1.0 if cut <= most_cut else max(most_cut, 0.0) / cut
    if cut * share < 0.1:
        return piece
    return Piece(piece.lane, piece.from_m + share * at_start_m, piece.to_m - share * at_end_m)
