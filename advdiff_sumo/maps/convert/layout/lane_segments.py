"""Which parts of each lane become SUMO edge lanes: cuts where a neighbour begins or ends.

Every centre line is kept as it is; a part of a lane that is no edge lane becomes part of the internal lanes of a
junction, so that a cut costs no geometry.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from advdiff_sumo.maps.convert.layout.neighbours import SideBySide

UNEVEN_M = (
    10.0  # neighbours whose ends differ by less are evened out at the junction, beyond it the longer is cut
)
ROOM_M = 7.5  # of an edge on which a car can wait clear of what is at its ends
CUT_M = 1.0  # length of the internal lane that bridges a cut


class Piece(NamedTuple):
    """Part of a lane, by lane number and arc lengths in m, that becomes a lane of a SUMO edge."""

    lane: int
    from_m: float
    to_m: float

    @property
    def length_m(self) -> float:
        """Length in m."""
        return self.to_m - self.from_m


def cut_lanes(lengths_m: Sequence[float], pairs: Sequence[SideBySide]) -> dict[int, list[Piece]]:
    """Return the pieces of each lane, in driving direction; a lane without a cut is one piece.

    A lane is cut where a neighbour begins or ends more than ``UNEVEN_M`` away from its own ends, and where lanes
    alongside are cut, so that all lanes of a road are cut abreast.
    """
    marks = _spread(_own_marks(lengths_m, pairs), lengths_m, pairs)
    return {lane: _between(lane, length, marks[lane]) for lane, length in enumerate(lengths_m)}


Mark = tuple[float, bool]  # arc length, whether a neighbour ends (rather than begins) there


def _own_marks(lengths_m: Sequence[float], pairs: Sequence[SideBySide]) -> list[tuple[int, Mark]]:
    """Return (lane, mark) where a neighbour comes or goes in the middle of a lane."""
    marks: list[tuple[int, Mark]] = []
    for pair in pairs:
        for lane in (pair.left, pair.right):
            first, last = pair.span(lane)
            if first > UNEVEN_M:
                marks.append((lane, (first, False)))
            if last < lengths_m[lane] - UNEVEN_M:
                marks.append((lane, (last, True)))
    return marks


def _spread(
    own: list[tuple[int, Mark]], lengths_m: Sequence[float], pairs: Sequence[SideBySide]
) -> list[list[Mark]]:
    """Return all marks of each lane after carrying each over to the lanes abreast."""
    beside: list[list[SideBySide]] = [[] for _ in lengths_m]
    for pair in pairs:
        beside[pair.left].append(pair)
        beside[pair.right].append(pair)
    marks: list[list[Mark]] = [[] for _ in lengths_m]
    queue = deque(own)
    while queue:
        lane, (s, ends) = queue.popleft()
        if any(abs(s - other) < 0.5 * CUT_M and ends == kind for other, kind in marks[lane]):
            continue
        marks[lane].append((s, ends))
        for pair in beside[lane]:
            other = pair.right if lane == pair.left else pair.left
            first, last = pair.span(lane)
            there = pair.across(lane, s)
            if first <= s <= last and UNEVEN_M < there < lengths_m[other] - UNEVEN_M:
                queue.append((other, (there, ends)))
    return marks


def _between(lane: int, length: float, marks: list[Mark]) -> list[Piece]:
    """Return what is left of a lane between its cuts; cuts that lie near each other are one."""
    cuts: list[list[float]] = []
    for s, ends in sorted(marks):
        low, high = (s, s + CUT_M) if ends else (s - CUT_M, s)
        if cuts and low - cuts[-1][1] < UNEVEN_M:
            cuts[-1][1] = max(cuts[-1][1], high)
        else:
            cuts.append([low, high])
    pieces, start = [], 0.0
    for low, high in cuts:
        pieces.append(Piece(lane, start, low))
        start = high
    return [*pieces, Piece(lane, start, length)]
