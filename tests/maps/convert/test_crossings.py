"""Edges are divided in the middle, so that the junctions at both ends can be joined."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Polygon

from advdiff_sumo.maps.convert.layout.crossings import _divide, join_crossing_lanes
from advdiff_sumo.maps.convert.layout.cut_crossings import _crossed_lanes
from advdiff_sumo.maps.convert.layout.lane_segments import CUT_M, Piece
from advdiff_sumo.maps.convert.layout.layout_state import Layout, joints_of
from advdiff_sumo.maps.on_foot.crossing_lines import band_of

RIGHT, LEFT = Piece(0, 10.0, 90.0), Piece(1, 12.0, 96.0)
OTHER = Piece(2, 0.0, 30.0)


def layout_of(lengths: Sequence[float], groups: list[list[Piece]]) -> Layout:
    pieces: dict[int, list[Piece]] = {lane: [] for lane in range(len(lengths))}
    for piece in sorted(piece for group in groups for piece in group):
        pieces[piece.lane].append(piece)
    layout = Layout(list(lengths), [], pieces, [list(group) for group in groups])
    layout.joints = joints_of(layout)
    for group in groups:
        for side in (0, 1):
            layout.joints.join([(piece, side) for piece in group])
    return layout


def test_an_edge_of_two_lanes_is_divided_in_its_middle() -> None:
    layout = layout_of([100.0, 102.0, 30.0], [[OTHER], [RIGHT, LEFT]])
    start, end = layout.junctions(RIGHT)
    _divide(layout, [RIGHT, LEFT])
    half = 0.5 * CUT_M  # the internal lane in the new junction is 1 m long
    first = [Piece(0, 10.0, 50.0 - half), Piece(1, 12.0, 54.0 - half)]
    second = [Piece(0, 50.0 + half, 90.0), Piece(1, 54.0 + half, 96.0)]
    assert layout.groups == [[OTHER], first, second]
    assert layout.pieces == {0: [first[0], second[0]], 1: [first[1], second[1]], 2: [OTHER]}
    same = layout.joints.find
    middle = {layout.junctions(piece)[1] for piece in first} | {
        layout.junctions(piece)[0] for piece in second
    }
    assert len(middle) == 1
    assert {layout.junctions(piece)[0] for piece in first} == {same(start)}
    assert {layout.junctions(piece)[1] for piece in second} == {same(end)}
    assert len({same(start), same(end), *middle}) == 3
    assert layout.counts["edges divided to join junctions where ways cross"] == 1


def test_a_lane_can_be_divided_where_others_go_before_and_after() -> None:
    before, long, after = Piece(0, 0.0, 20.0), Piece(0, 21.0, 81.0), Piece(0, 82.0, 100.0)
    layout = layout_of([100.0], [[before], [long], [after]])
    _divide(layout, [long])
    half = 0.5 * CUT_M
    assert layout.pieces[0] == [before, Piece(0, 21.0, 51.0 - half), Piece(0, 51.0 + half, 81.0), after]
    assert layout.junctions(before)[1] == layout.junctions(layout.pieces[0][1])[0]
    assert layout.junctions(layout.pieces[0][2])[1] == layout.junctions(after)[0]


@pytest.mark.parametrize(("between_m", "divided"), [(60.0, 1), (15.0, 0)])
def test_ways_that_cross_come_into_one_junction(between_m: float, divided: bool) -> None:
    """Lane 0 has an internal part of 10 m at either end; the internal part of lane 1 crosses both.

    A long piece between them is divided, a short one goes inside the junction.
    """
    piece, far = Piece(0, 10.0, 10.0 + between_m), Piece(1, 0.0, 5.0)
    lines = [
        np.array([[0.0, 0.0], [20.0 + between_m, 0.0]]),
        np.array([[-40.0, -2.0], [-5.0, -1.0], [5.0, 1.0], [5.0, 20.0], [15.0 + between_m, 20.0]]),
    ]
    lines[1] = np.vstack((lines[1], [[15.0 + between_m, -10.0], [15.0 + between_m, -40.0]]))
    length = float(np.hypot(*np.diff(lines[1], axis=0).T).sum())
    rim = [Piece(0, 0.0, 2.0), Piece(0, 18.0 + between_m, 20.0 + between_m)]
    ends = [far, Piece(1, length - 5.0, length)]
    layout = layout_of([20.0 + between_m, length], [[rim[0]], [piece], [rim[1]], [ends[0]], [ends[1]]])
    assert len(set(layout.junctions(piece))) == 2
    join_crossing_lanes(layout, lines)
    assert layout.counts["edges divided to join junctions where ways cross"] == divided
    assert layout.counts["pieces put inside a junction"] == (not divided)
    assert layout.junctions(rim[0])[1] == layout.junctions(rim[1])[0] == layout.junctions(ends[0])[1]
    for own in layout.all_pieces():
        assert len(set(layout.junctions(own))) == 2  # no edge begins and ends in one junction


def test_a_crossing_at_the_first_centimetres_of_a_bent_lane_leads_over_it() -> None:
    """The lane ends beside its beginning, so that the direction from end to beginning runs along the crossing."""
    lane = LineString([(0.0, 0.0), (50.0, 0.0), (50.0, 50.0), (0.0, 50.0)])
    area = Polygon([(-1.5, -3.0), (1.7, -3.0), (1.7, 3.0), (-1.5, 3.0)])  # its axis is at x = 0.1
    band = band_of(area, [lane])
    assert band is not None
    layout = layout_of([lane.length], [[Piece(0, 0.0, lane.length)]])
    (crossed,) = _crossed_lanes(layout, band, [lane], shapely.STRtree([lane]), [3.5]) or []
    assert crossed.from_m == 0.0
    assert crossed.to_m == pytest.approx(0.1 + 0.5 * 3.2 + 0.5, abs=0.01)
