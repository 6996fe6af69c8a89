"""The state that the layout steps share: pieces of lanes, their groups and the junctions that they meet in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field

from advdiff_sumo.maps.convert.layout.joints import Joints
from advdiff_sumo.maps.convert.layout.lane_segments import Piece


@dataclass
class Layout:
    """What becomes of every lane; built up step by step by :func:`lay_out`.

    Attributes:
        lengths_m: length of each lane and connector.
        links: ordered pairs of lane numbers.
        pieces: edge lanes of each lane in driving direction; the rest of a lane lies inside junctions.
        groups: pieces of each edge, from right to left in driving direction.
        joints: which ends of pieces meet in one junction; kept up while pieces are grouped and joined.
        counts: what had to be cut, promoted, absorbed or left apart.
    """

    lengths_m: list[float]
    links: list[tuple[int, int]]
    pieces: dict[int, list[Piece]]
    groups: list[list[Piece]] = field(default_factory=list)
    joints: Joints = field(default_factory=Joints)
    counts: Counter[str] = field(default_factory=Counter)

    def all_pieces(self) -> list[Piece]:
        """Return every piece, ordered by lane and arc length."""
        return [piece for lane in sorted(self.pieces) for piece in self.pieces[lane]]

    def replace(self, piece: Piece, new: Piece) -> None:
        """Put *new*, a shorter one, in the place of *piece*."""
        own = self.pieces[piece.lane]
        own[own.index(piece)] = new
        for side in (0, 1):
            self.joints.join(((piece, side), (new, side)))

    def part(self, group: list[Piece], first: list[Piece], second: list[Piece]) -> list[Hashable]:
        """Put the edges *first* and *second* in the place of *group*, lane by lane; return their ends between them."""
        for piece, before, after in zip(group, first, second, strict=True):
            own = self.pieces[piece.lane]
            own[own.index(piece) : own.index(piece) + 1] = [before, after]
            self.joints.join(((piece, 0), (before, 0)))
            self.joints.join(((piece, 1), (after, 1)))
        at = self.groups.index(group)
        self.groups[at : at + 1] = [first, second]
        return [*((piece, 1) for piece in first), *((piece, 0) for piece in second)]

    def junctions(self, piece: Piece) -> tuple[Hashable, Hashable]:
        """Return the junctions at which *piece* begins and ends."""
        return self.joints.find((piece, 0)), self.joints.find((piece, 1))

    def between(self, junctions: set[Hashable]) -> list[Piece]:
        """Return the pieces that begin and end in *junctions*, ordered by lane and arc length."""
        ends = set[Hashable]().union(*(self.joints.members(junction) for junction in junctions))
        begun = {end[0] for end in ends if isinstance(end, tuple) and isinstance(end[0], Piece)}
        within = {piece for piece in begun if {(piece, 0), (piece, 1)} <= ends}
        return sorted(piece for piece in within if piece in self.pieces[piece.lane])


def joints_of(layout: Layout, more: Iterable[tuple[Hashable, Hashable]] = ()) -> Joints:
    """Return which ends of pieces and lanes meet in one junction, before lanes are grouped; *more* pairs meet too."""
    joints = Joints()
    for first, second in (*bonds_of(layout), *more):
        joints.join((first, second))
    for piece in layout.all_pieces():
        joints.find((piece, 0))
        joints.find((piece, 1))
    return joints


def bonds_of(layout: Layout) -> Iterable[tuple[Hashable, Hashable]]:
    """Yield pairs of ends that a link, a connector or a bridged cut joins."""
    for lane in range(len(layout.lengths_m)):
        before: Hashable = (lane, "start")
        for piece in layout.pieces[lane]:
            yield before, (piece, 0)
            before = (piece, 1)
        yield before, (lane, "end")
    for a, b in layout.links:
        yield (a, "end"), (b, "start")
