"""From lanes and links to SUMO edges: which pieces share an edge and which ends share a junction."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m
from advdiff_sumo.maps.convert.layout.clear_stretches import STUB_M, clear_stretches
from advdiff_sumo.maps.convert.layout.crossings import join_crossing_ways
from advdiff_sumo.maps.convert.layout.grouping import KEEP_SHARE, group_pieces
from advdiff_sumo.maps.convert.layout.lane_segments import CUT_M, Piece, cut_lanes
from advdiff_sumo.maps.convert.layout.layout_state import Layout, joints_of
from advdiff_sumo.maps.convert.layout.neighbours import SideBySide
from advdiff_sumo.maps.convert.layout.part_junctions import break_loops, part_crossings, part_second_ways

SHORTEST_EDGE_M = 1.0  # netconvert moves the ends of shorter edges


def lay_out(
    lines_m: Sequence[FloatArray],
    is_connector: Sequence[bool],
    links: Sequence[tuple[int, int]],
    pairs: Sequence[SideBySide],
) -> Layout:
    """Return the layout of a map.

    Args:
        lines_m: centre line (N, 2) of each lane and connector.
        is_connector: whether each of them is a connector, which becomes an internal lane where it can.
        links: ordered pairs (from, to) of lane numbers.
        pairs: lanes that run side by side.
    """
    roads = [pair for pair in pairs if not (is_connector[pair.left] or is_connector[pair.right])]
    lengths = [line_length_m(line) for line in lines_m]
    cut = cut_lanes(lengths, roads)
    pieces = {lane: ([] if is_connector[lane] else cut[lane]) for lane in range(len(lengths))}
    layout = Layout(lengths, list(links), pieces)
    layout.counts["lanes cut"] = sum(len(own) > 1 for own in pieces.values())
    _open_ends(layout, is_connector)
    _direct_links(layout, is_connector)
    clear = clear_stretches(lines_m, is_connector)
    part_second_ways(layout, clear)
    break_loops(layout, clear)
    part_crossings(layout, clear, lines_m)
    layout.joints = joints_of(layout)
    join_crossing_ways(layout, lines_m, frozenset(lane for pair in roads for lane in (pair.left, pair.right)))
    layout.groups = group_pieces(layout, roads)
    _even_out(layout, roads)
    join_crossing_ways(layout, lines_m)
    return layout


def _open_ends(layout: Layout, is_connector: Sequence[bool]) -> None:
    """Give each connector that leads nowhere or comes from nowhere (the rim of the map) an edge at its open end."""
    has_next = {a for a, _ in layout.links}
    has_previous = {b for _, b in layout.links}
    for lane, length in enumerate(layout.lengths_m):
        if not is_connector[lane] or (lane in has_next and lane in has_previous):
            continue
        stub = min(STUB_M, 0.5 * length)
        start = length - stub if lane in has_previous else 0.0
        end = stub if lane in has_next else length
        layout.pieces[lane] = [Piece(lane, start, end)]
        layout.counts["connectors that end at the rim"] += 1


def _direct_links(layout: Layout, is_connector: Sequence[bool]) -> None:
    """Give room for an internal lane where one lane follows another without a connector."""
    shorten: dict[int, set[int]] = defaultdict(set)
    for a, b in layout.links:
        if layout.pieces[a] and layout.pieces[b] and not (is_connector[a] or is_connector[b]):
            shorten[a].add(-1)
            shorten[b].add(0)
    for lane, ends in sorted(shorten.items()):
        for end in sorted(ends):
            piece = layout.pieces[lane][end]
            cut = min(0.5 * CUT_M, 0.2 * piece.length_m)
            shorter = (piece.from_m + cut, piece.to_m) if end == 0 else (piece.from_m, piece.to_m - cut)
            layout.pieces[lane][end] = Piece(lane, *shorter)


def _even_out(layout: Layout, pairs: Sequence[SideBySide]) -> None:
    """Shorten the lanes of each edge so that they begin and end abreast; the rest lies inside the junctions."""
    beside = {(pair.right, pair.left): pair for pair in pairs}
    followed, entered = {a for a, _ in layout.links}, {b for _, b in layout.links}
    for number, group in enumerate(layout.groups):
        starts, ends = _offsets(group, beside, 0), _offsets(group, beside, 1)
        shorter = []
        for piece, start, end in zip(group, starts, ends, strict=True):
            new = _shortened(piece, max(starts) - start, end - min(ends))
            new = _keep_open_end(layout, piece, new, 0) if piece.lane not in entered else new
            new = _keep_open_end(layout, piece, new, 1) if piece.lane not in followed else new
            layout.counts["lane ends shortened to even an edge"] += (new.from_m > piece.from_m) + (
                new.to_m < piece.to_m
            )
            shorter.append(new)
            layout.replace(piece, new)
        layout.groups[number] = shorter
    layout.groups += _open_ends_left(layout)


def _keep_open_end(layout: Layout, piece: Piece, new: Piece, side: int) -> Piece:
    """Keep what is taken off at the rim of the map, where no way would draw it: as a piece of its own, if it is long.

    Args:
        layout: what is being built; a piece that is kept is added to it.
        piece: the piece as it was.
        new: the piece as it is to be.
        side: the open end, 0 for the beginning of the lane and 1 for its end.
    """
    own = layout.pieces[piece.lane]
    taken = new.from_m - piece.from_m if side == 0 else piece.to_m - new.to_m
    if taken <= 0.0 or own[-side] != piece:
        return new
    if taken < CUT_M + SHORTEST_EDGE_M:
        return new._replace(from_m=piece.from_m) if side == 0 else new._replace(to_m=piece.to_m)
    if side == 0:
        rest = Piece(piece.lane, piece.from_m, new.from_m - CUT_M)
    else:
        rest = Piece(piece.lane, new.to_m + CUT_M, piece.to_m)
    own.insert(0 if side == 0 else len(own), rest)
    layout.joints.join(((piece, side), (rest, 1 - side)))
    layout.counts["open ends cut off to even an edge"] += 1
    return new


def _open_ends_left(layout: Layout) -> list[list[Piece]]:
    """Return pieces in no group yet, each as a group of its own."""
    grouped = {piece for group in layout.groups for piece in group}
    return [[piece] for piece in layout.all_pieces() if piece not in grouped]


def _offsets(group: list[Piece], beside: dict[tuple[int, int], SideBySide], side: int) -> list[float]:
    """Return where each piece begins (side 0) or ends (1), as arc length along the rightmost lane."""
    offsets = []
    for index, piece in enumerate(group):
        s = piece.to_m if side else piece.from_m
        for right, left in zip(group[index - 1 :: -1] if index else [], group[index:0:-1], strict=True):
            s = beside[(right.lane, left.lane)].across(left.lane, s)
        offsets.append(s)
    return offsets


def _shortened(piece: Piece, at_start_m: float, at_end_m: float) -> Piece:
    cut = at_start_m + at_end_m
    room = min((1.0 - KEEP_SHARE) * piece.length_m, piece.length_m - SHORTEST_EDGE_M)
    if cut <= 0.0:
        return piece
    share = 1.0 if cut <= room else max(room, 0.0) / cut
    if cut * share < 0.1:
        return piece
    return Piece(piece.lane, piece.from_m + share * at_start_m, piece.to_m - share * at_end_m)
