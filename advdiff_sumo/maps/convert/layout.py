"""From lanes and links to SUMO edges: which pieces share an edge and which ends share a junction."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, field

from advdiff_sumo.maps.convert.joints import Joints
from advdiff_sumo.maps.convert.neighbours import SideBySide
from advdiff_sumo.maps.convert.pieces import CUT_M, UNEVEN_M, Piece, cut_lanes

SHORTEST_EDGE_M = 1.0  # netconvert moves the ends of shorter edges
PROMOTE_M = 4.0  # a connector at least this long may become an edge of its own
KEEP_SHARE = 0.5  # evening out the ends of an edge leaves at least this share of each lane


@dataclass
class Layout:
    """What becomes of every lane; built up step by step by :func:`lay_out`.

    Attributes:
        lengths_m: length of each lane and connector.
        links: ordered pairs of lane numbers.
        pieces: edge lanes of each lane in driving direction; the rest of a lane lies inside junctions.
        groups: pieces of each edge, from right to left in driving direction.
        counts: what had to be cut, promoted, absorbed or left apart.
    """

    lengths_m: list[float]
    links: list[tuple[int, int]]
    pieces: dict[int, list[Piece]]
    groups: list[list[Piece]] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def all_pieces(self) -> list[Piece]:
        """Return every piece, ordered by lane and arc length."""
        return [piece for lane in sorted(self.pieces) for piece in self.pieces[lane]]


def lay_out(
    lengths_m: Sequence[float],
    is_connector: Sequence[bool],
    links: Sequence[tuple[int, int]],
    pairs: Sequence[SideBySide],
) -> Layout:
    """Return the layout of a map.

    Args:
        lengths_m: length of each lane and connector.
        is_connector: whether each of them is a connector, which becomes an internal lane where it can.
        links: ordered pairs (from, to) of lane numbers.
        pairs: lanes that run side by side.
    """
    roads = [pair for pair in pairs if not (is_connector[pair.left] or is_connector[pair.right])]
    cut = cut_lanes(lengths_m, roads)
    pieces = {lane: ([] if is_connector[lane] else cut[lane]) for lane in range(len(lengths_m))}
    layout = Layout(list(lengths_m), list(links), pieces)
    layout.counts["lanes cut"] = sum(len(own) > 1 for own in pieces.values())
    _open_ends(layout, is_connector)
    _direct_links(layout, is_connector)
    _break_loops(layout, is_connector)
    layout.groups = _group(layout, roads)
    _even_out(layout, roads)
    return layout


def _open_ends(layout: Layout, is_connector: Sequence[bool]) -> None:
    """Make an edge of each connector that leads nowhere or comes from nowhere (the rim of the map)."""
    has_next = {a for a, _ in layout.links}
    has_previous = {b for _, b in layout.links}
    for lane, length in enumerate(layout.lengths_m):
        if is_connector[lane] and not (lane in has_next and lane in has_previous):
            margin = min(CUT_M, 0.25 * length)
            start = margin if lane in has_previous else 0.0
            end = length - margin if lane in has_next else length
            layout.pieces[lane] = [Piece(lane, start, end)]
            layout.counts["connectors at the rim made edges"] += 1


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


def joints_of(layout: Layout) -> Joints:
    """Return which ends of pieces and lanes meet in one junction, before lanes are grouped."""
    joints = Joints()
    for first, second in _bonds(layout):
        joints.join((first, second))
    for piece in layout.all_pieces():
        joints.find((piece, 0))
        joints.find((piece, 1))
    return joints


def _bonds(layout: Layout) -> Iterable[tuple[Hashable, Hashable]]:
    """Yield pairs of ends that a link, a connector or a bridged cut joins."""
    for lane in range(len(layout.lengths_m)):
        before: Hashable = (lane, "start")
        for piece in layout.pieces[lane]:
            yield before, (piece, 0)
            before = (piece, 1)
        yield before, (lane, "end")
    for a, b in layout.links:
        yield (a, "end"), (b, "start")


def _break_loops(layout: Layout, is_connector: Sequence[bool]) -> None:
    """Make sure that no piece begins and ends in one junction.

    Where a connector bypasses a lane, the ends of that lane would fall into one junction; the longest connector
    on the shortest way round becomes an edge of its own. A lane without such a way is put inside the junction.
    """
    while True:
        joints = joints_of(layout)
        looped = [p for p in layout.all_pieces() if joints.find((p, 0)) == joints.find((p, 1))]
        if not looped:
            return
        piece = min(looped, key=lambda p: (-p.length_m, p))
        way = _way_round(layout, piece)
        fit = [c for c in way if is_connector[c] and not layout.pieces[c] and layout.lengths_m[c] >= PROMOTE_M]
        if fit:
            best = max(fit, key=lambda c: (layout.lengths_m[c], -c))
            layout.pieces[best] = [Piece(best, CUT_M, layout.lengths_m[best] - CUT_M)]
            layout.counts["connectors made edges to part junctions"] += 1
        else:
            layout.pieces[piece.lane].remove(piece)
            layout.counts["pieces put inside a junction"] += 1


def _way_round(layout: Layout, piece: Piece) -> list[int]:
    """Return the lanes without pieces on the shortest chain that joins the two ends of *piece*."""
    beside: dict[Hashable, list[Hashable]] = defaultdict(list)
    for a, b in _bonds(layout):
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


@dataclass(frozen=True)
class _Match:
    """A pair of pieces that could share an edge, *left* beside *right*."""

    left: Piece
    right: Piece
    overlap_m: float


def _matches(layout: Layout, pairs: Sequence[SideBySide]) -> list[_Match]:
    """Return pairs of pieces abreast whose ends differ by little, longest first."""
    found = []
    for pair in pairs:
        for left in layout.pieces[pair.left]:
            start, end = pair.across(pair.left, left.from_m), pair.across(pair.left, left.to_m)
            for right in layout.pieces[pair.right]:
                overlap = min(end, right.to_m) - max(start, right.from_m)
                uneven = max(abs(start - right.from_m), abs(end - right.to_m))
                if overlap >= KEEP_SHARE * max(right.length_m, end - start) and uneven <= UNEVEN_M + 2 * CUT_M:
                    found.append(_Match(left, right, overlap))
    return sorted(found, key=lambda m: (-m.overlap_m, m.left, m.right))


def _group(layout: Layout, pairs: Sequence[SideBySide]) -> list[list[Piece]]:
    """Return the pieces of each edge, right to left; pieces are put together where no junction loop comes of it."""
    joints = joints_of(layout)
    left_of: dict[Piece, Piece] = {}
    right_of: dict[Piece, Piece] = {}
    for match in _matches(layout, pairs):
        if match.right in left_of or match.left in right_of:
            layout.counts["neighbours with another neighbour already"] += 1
            continue
        if _would_loop(layout, joints, match):
            layout.counts["neighbours kept apart by junctions"] += 1
            continue
        left_of[match.right], right_of[match.left] = match.left, match.right
        for side in (0, 1):
            joints.join(((match.left, side), (match.right, side)))
    return [_chain(piece, left_of) for piece in layout.all_pieces() if piece not in right_of]


def _would_loop(layout: Layout, joints: Joints, match: _Match) -> bool:
    """Return whether putting two pieces into one edge makes some edge begin and end in one junction.

    Short remainders of cut lanes that would are put inside the junction instead.
    """
    starts = {joints.find((match.left, 0)), joints.find((match.right, 0))}
    ends = {joints.find((match.left, 1)), joints.find((match.right, 1))}
    if starts & ends:
        return True
    for piece in layout.all_pieces():
        pair = {joints.find((piece, 0)), joints.find((piece, 1))}
        if pair <= starts or pair <= ends:
            return True
    return False


def _chain(piece: Piece, left_of: dict[Piece, Piece]) -> list[Piece]:
    chain = [piece]
    while chain[-1] in left_of:
        chain.append(left_of[chain[-1]])
    return chain


def _even_out(layout: Layout, pairs: Sequence[SideBySide]) -> None:
    """Shorten the lanes of each edge so that they begin and end abreast; the rest lies inside the junctions."""
    beside = {(pair.right, pair.left): pair for pair in pairs}
    for number, group in enumerate(layout.groups):
        starts, ends = _offsets(group, beside, 0), _offsets(group, beside, 1)
        shorter = []
        for piece, start, end in zip(group, starts, ends, strict=True):
            new = _shortened(piece, max(starts) - start, end - min(ends))
            layout.counts["lane ends shortened to even an edge"] += (new.from_m > piece.from_m) + (new.to_m < piece.to_m)
            shorter.append(new)
            own = layout.pieces[piece.lane]
            own[own.index(piece)] = new
        layout.groups[number] = shorter


def _offsets(group: list[Piece], beside: dict[tuple[int, int], SideBySide], side: int) -> list[float]:
    """Return where each piece begins (side 0) or ends (1), as arc length along the rightmost lane."""
    found = []
    for index, piece in enumerate(group):
        s = piece.to_m if side else piece.from_m
        for right, left in zip(group[index - 1 :: -1] if index else [], group[index:0:-1], strict=True):
            s = beside[(right.lane, left.lane)].across(left.lane, s)
        found.append(s)
    return found


def _shortened(piece: Piece, at_start_m: float, at_end_m: float) -> Piece:
    cut = at_start_m + at_end_m
    room = min((1.0 - KEEP_SHARE) * piece.length_m, piece.length_m - SHORTEST_EDGE_M)
    share = 1.0 if cut <= room else max(room, 0.0) / cut
    if cut * share < 0.1:
        return piece
    return Piece(piece.lane, piece.from_m + share * at_start_m, piece.to_m - share * at_end_m)
