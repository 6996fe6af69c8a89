"""Junctions are divided on a connector, at a stretch with no other lane near."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.maps.convert.layout.clear_stretches import STUB_M, clear_stretches
from advdiff_sumo.maps.convert.layout.lane_segments import Piece
from advdiff_sumo.maps.convert.layout.lay_out import lay_out


def line(*points: tuple[float, float]) -> FloatArray:
    """Return a line through *points*."""
    return np.array(points, dtype=np.float64)


def test_the_clear_stretch_ends_where_another_lane_is_near() -> None:
    across = line((30.0, -20.0), (30.0, 20.0))
    clear = clear_stretches([line((0.0, 0.0), (100.0, 0.0)), across], [True, False])
    assert list(clear) == [0]
    assert clear[0].from_m == pytest.approx(32.2, abs=0.01)
    assert clear[0].to_m == pytest.approx(100.0)


def test_without_a_clear_stretch_it_is_the_middle() -> None:
    lines = [line((0.0, 0.0), (40.0, 0.0)), line((0.0, 2.0), (40.0, 2.0))]
    clear = clear_stretches(lines, [True, True])
    assert clear[0] == Piece(0, 20.0 - 0.5 * STUB_M, 20.0 + 0.5 * STUB_M)


CROSSING = [
    line((-100.0, 0.0), (-50.0, 0.0)),  # 0: into the first junction
    line((-50.0, 0.0), (0.0, 0.0)),  # 1: straight through it
    line((0.0, 0.0), (8.0, 0.0)),  # 2: between the two junctions
    line((8.0, 0.0), (60.0, 0.0)),  # 3: straight through the second one
    line((60.0, 0.0), (100.0, 0.0)),  # 4: out of it
    line((-50.0, 0.0), (-50.0, 40.0), (60.0, 40.0)),  # 5: from 0 round the block, across 6
    line((8.0, 0.0), (8.0, 80.0)),  # 6: from 2 across 5
    line((60.0, 40.0), (100.0, 40.0)),  # 7: after 5
    line((8.0, 80.0), (8.0, 120.0)),  # 8: after 6
]
INSIDE = [False, True, False, True, False, True, True, False, False]
LINKS = [(0, 1), (1, 2), (2, 3), (3, 4), (0, 5), (5, 7), (2, 6), (6, 8)]


def test_a_lane_between_two_junctions_stays_an_edge_though_their_ways_cross() -> None:
    """Connector 5 becomes an edge from 2.2 m beyond lane 0 and connector 1 to 2.2 m before connector 6, at 95.8 m."""
    layout = lay_out(CROSSING, INSIDE, LINKS, [])
    assert layout.pieces[2] == [Piece(2, 0.0, 8.0)]
    first, second = layout.junctions(layout.pieces[2][0])
    assert first != second
    (edge,) = layout.pieces[5]
    assert edge.from_m == pytest.approx(2.2, abs=0.01)
    assert edge.to_m == pytest.approx(95.8, abs=0.01)
    assert layout.junctions(edge) == (first, second)  # the crossing belongs to the second junction


def test_where_no_car_could_wait_the_lane_becomes_part_of_one_junction() -> None:
    """All of connector 5 is within 2.2 m of others; 5.8 m of connector 6 are clear."""
    lines = [
        line((-100.0, 0.0), (-5.0, 0.0)),
        line((-5.0, 0.0), (0.0, 0.0)),
        line((0.0, 0.0), (8.0, 0.0)),
        line((8.0, 0.0), (15.0, 0.0)),
        line((15.0, 0.0), (100.0, 0.0)),
        line((-5.0, 0.0), (-5.0, 2.0), (15.0, 2.0)),
        line((8.0, 0.0), (8.0, 10.0)),
        line((15.0, 2.0), (100.0, 2.0)),
        line((8.0, 10.0), (8.0, 80.0)),
    ]
    layout = lay_out(lines, INSIDE, LINKS, [])
    assert [layout.pieces[lane] for lane in (2, 5, 6)] == [[], [], []]
    assert layout.counts["pieces put inside a junction"] == 1
