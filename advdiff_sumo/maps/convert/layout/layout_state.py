"""State that the layout steps share: pieces of lanes, their groups (edges) and the junctions between them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field
from functools import cached_property

from advdiff_sumo.maps.convert.layout.joints import Joints
from advdiff_sumo.maps.convert.layout.lane_segments import Piece


@dataclass
class Layout:
    """Division of all source lanes into edges and junctions; :func:`lay_out` builds it step by step.

    Attributes:
        lengths_m: length of each lane and connector.
        links: ordered pairs of lane numbers.
        pieces: for each lane, its parts that become edge lanes, in driving direction; the other parts become internal
            lanes of junctions.
        groups: pieces of each edge, from right to left in driving direction.
        joints: which ends of pieces meet in one junction; updated whenever pieces change.
        counts: number of changes and unresolved cases of each kind.
    """

    lengths_m: list[float]
    links: list[tuple[int, int]]
    pieces: dict[int, list[Piece]]
    groups: list[list[Piece]] = field(default_factory=list)
    joints: Joints = field(default_factory=Joints)
    counts: Counter[str] = field(default_factory=Counter)

    @cached_property
    def has_next(self) -> frozenset[int]:
        """Lanes from which a link leads."""
        return frozenset(a for a, _ in self.links)

    @cached_property
    def has_previous(self) -> frozenset[int]:
        """Lanes to which a link leads."""
        return frozenset(b for _, b in self.links)

    def all_pieces(self) -> list[Piece]:
        """Return every piece, ordered by lane and arc length."""
        return [piece for lane in sorted(self.pieces) for piece in self.pieces[lane]]

    def replace(self, piece: Piece, new: Piece) -> None:
        """Replace *piece* by *new*, a shorter one."""
        lane_pieces = self.pieces[piece.lane]
        lane_pieces[lane_pieces.index(piece)] = new
        for side in (0, 1):
            self.joints.join(((piece, side), (new, side)))

    def part(self, group: list[Piece], first: list[Piece], second: list[Piece]) -> list[Hashable]:
        """Replace the edge *group* by the edges *first* and *second*; return the lane ends between the two."""
        for piece, before, after in zip(group, first, second, strict=True):
            lane_pieces = self.pieces[piece.lane]
            at = lane_pieces.index(piece)
            lane_pieces[at : at + 1] = [before, after]
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


def joints_of(layout: Layout, extra_pairs: Iterable[tuple[Hashable, Hashable]] = ()) -> Joints:
    """Return which ends of pieces and lanes meet in one junction, before lanes are grouped; *extra_pairs* meet too."""
    joints = Joints()
    for first, second in (*linked_ends(layout), *extra_pairs):
        joints.join((first, second))
    for piece in layout.all_pieces():
        joints.find((piece, 0))
        joints.find((piece, 1))
    return joints


def linked_ends(layout: Layout) -> Iterable[tuple[Hashable, Hashable]]:
    """Yield the pairs of lane ends that a link or an internal part of a lane joins."""
    for lane in range(len(layout.lengths_m)):
        before: Hashable = (lane, "start")
        for piece in layout.pieces[lane]:
            yield before, (piece, 0)
            before = (piece, 1)
        yield before, (lane, "end")
    for a, b in layout.links:
        yield (a, "end"), (b, "start")
