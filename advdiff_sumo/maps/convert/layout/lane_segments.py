"""Cut lanes into the parts that become SUMO edge lanes, where a neighbouring lane begins or ends.

Centre lines are not changed. The parts of a lane that are not edge lanes become internal lanes of junctions, so no
geometry is lost by a cut.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from advdiff_sumo.maps.convert.layout.neighbours import SideBySide

# Neighbours whose ends differ by less are shortened to the same length; otherwise the longer one is cut.
UNEVEN_M = 10.0
ROOM_M = 7.5  # shortest edge on which a car can wait without reaching into the junctions at its ends
CUT_M = 1.0  # length of the internal lane that bridges a cut


class Piece(NamedTuple):
    """Part of a lane, by lane number and arc lengths in m; usually one that becomes an edge lane in SUMO."""

    lane: int
    from_m: float
    to_m: float

    @property
    def length_m(self) -> float:
        """Length in m."""
        return self.to_m - self.from_m


def cut_lanes(lengths_m: Sequence[float], pairs: Sequence[SideBySide]) -> dict[int, list[Piece]]:
    """Return the pieces of each lane, in driving direction; a lane without a cut is one piece.

    A lane is cut where a neighbour begins or ends more than ``UNEVEN_M`` away from its own ends. It is also cut where
    neighbouring lanes are cut, so that all lanes of a road are cut side by side.
    """
    marks = _spread_marks(_own_marks(lengths_m, pairs), lengths_m, pairs)
    return {lane: _pieces_between(lane, length, marks[lane]) for lane, length in enumerate(lengths_m)}


Mark = tuple[float, bool]  # arc length, and whether a neighbour ends (otherwise begins) there


def _own_marks(lengths_m: Sequence[float], pairs: Sequence[SideBySide]) -> list[tuple[int, Mark]]:
    """Return (lane, mark) wherever a neighbour begins or ends along a lane, away from the lane's own ends."""
    marks: list[tuple[int, Mark]] = []
    for pair in pairs:
        for lane in (pair.left, pair.right):
            first, last = pair.span(lane)
            if first > UNEVEN_M:
                marks.append((lane, (first, False)))
            if last < lengths_m[lane] - UNEVEN_M:
                marks.append((lane, (last, True)))
    return marks


def _spread_marks(
    own_marks: list[tuple[int, Mark]], lengths_m: Sequence[float], pairs: Sequence[SideBySide]
) -> list[list[Mark]]:
    """Return all marks of each lane: its own ones, and those of neighbouring lanes at the stations beside them."""
    pairs_of_lane: list[list[SideBySide]] = [[] for _ in lengths_m]
    for pair in pairs:
        pairs_of_lane[pair.left].append(pair)
        pairs_of_lane[pair.right].append(pair)
    marks: list[list[Mark]] = [[] for _ in lengths_m]
    queue = deque(own_marks)
    while queue:
        lane, (s, ends) = queue.popleft()
        if any(abs(s - known_s) < 0.5 * CUT_M and ends == kind for known_s, kind in marks[lane]):
            continue
        marks[lane].append((s, ends))
        for pair in pairs_of_lane[lane]:
            neighbour = pair.right if lane == pair.left else pair.left
            first, last = pair.span(lane)
            neighbour_s = pair.across(lane, s)
            if first <= s <= last and UNEVEN_M < neighbour_s < lengths_m[neighbour] - UNEVEN_M:
                queue.append((neighbour, (neighbour_s, ends)))
    return marks


def _pieces_between(lane: int, length: float, marks: list[Mark]) -> list[Piece]:
    """Return the pieces of a lane between its cuts at *marks*; cuts close to each other become one."""
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
