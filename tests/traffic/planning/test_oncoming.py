"""The wrong side of the road, on the shipped downtown's lanes of 3.25 m and their twins in the other direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.planning.road_bound import OVER_M, drives_against, over_line_m
from tests.sim import nets
from tests.traffic.planning.test_safeguard import guarded, lane, on

__all__ = ["lane"]  # a fixture


@pytest.mark.parametrize(
    ("left", "turn", "depth"),
    [
        (0.0, 0.0, 0.0),
        (1.6, 0.0, 0.0),
        (2.0, 0.0, 0.375),  # 2 − 3.25 / 2
        (3.0, 0.0, 1.375),
        (4.0, 0.0, 0.875),  # beyond the middle of the other lane, 0.75 m: 1.625 − 0.75
        (0.0, np.pi, 1.625),  # the middle of a lane against its direction
        (3.25, np.pi, 0.0),
        (3.0, 0.5 * np.pi, 0.0),  # crosses the road at right angles
    ],
)
def test_how_far_a_point_is_over_the_line(
    downtown: RoadMap, lane: Lane, left: float, turn: float, depth: float
) -> None:
    xy, yaw = lane.line.at(np.array([12.0]), left)
    assert over_line_m(downtown, xy, yaw + turn).tolist() == pytest.approx([depth], abs=2e-3)


def test_on_a_junction_areas_shared_with_a_lane_along_the_heading_do_not_count(tmp_path: Path) -> None:
    """A crossing of 3.2 m lanes: its centre lines at y = −1.6 lead east, at y = 1.6 west; turns fill its middle."""
    road = RoadMap.read(nets.crossing(tmp_path))
    begin = float(road.junctions["C"].shape_xy_m[:, 0].min())
    at = np.array([[begin + 1.0, -1.6], [begin + 1.0, 0.6], [begin + 1.0, 1.6], [1.0, -5.0]])
    depth = over_line_m(road, at, np.zeros(len(at)))
    assert depth[0] == 0.0
    assert depth[1] >= 0.6, "of the lane whose edge is at 0; a turn into it may lie nearer"
    assert depth[2] == pytest.approx(1.6, abs=0.02)
    assert depth[3] == 0.0, "no lane is opposite there"
    turn = next(link for link in road.lanes["WC_0"].successors if link.to_lane == "CN_0")
    for inner in (road.lanes[name] for name in turn.via):
        for left in (-0.9, 0.0, 0.9):
            xy, yaw = inner.line.at(np.linspace(0.0, inner.length_m, 9), left)
            assert over_line_m(road, xy, yaw).tolist() == [0.0] * 9, "it crosses an opposite lane"


@pytest.mark.parametrize(
    ("left", "speed", "against"),
    [(0.0, 4.0, False), (0.9, 4.0, True), (-0.5, 4.0, False), (0.9, 0.0, False)],
)
def test_plans_over_the_line(downtown: RoadMap, lane: Lane, left: float, speed: float, against: bool) -> None:
    """A car of 1.9 m that is 0.9 m left of the middle has its front corner 0.23 m over the line, and drifts there."""
    plans = on(lane, 10.0, speed, left=left)
    everybody = np.array([True, True])
    assert OVER_M == 0.3
    assert drives_against(downtown, plans, everybody)[1] == against
    assert guarded(downtown, plans).follows_lane[1] == against
    assert not drives_against(downtown, plans, ~everybody).any()


def test_attackers_may_drive_on_the_wrong_side_and_others_return_to_their_lane(
    downtown: RoadMap, lane: Lane
) -> None:
    plans = on(lane, 10.0, 6.0, left=2.0)
    free = guarded(downtown, plans, attacks=True)
    np.testing.assert_array_equal(free.futures.xy_m, plans.xy_m)
    made = guarded(downtown, plans)
    s, d = lane.line.project(made.futures.xy_m[1, :9])
    assert d[0] == pytest.approx(2.0)
    assert abs(d[-1]) < 0.3
    assert (np.diff(s) > 0.0).all()
