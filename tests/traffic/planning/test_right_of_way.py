"""Which vehicles must yield, on a crossing whose street along x has priority."""

from __future__ import annotations

import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead, lane_ahead
from advdiff_sumo.traffic.planning.right_of_way import right_of_way
from tests.sim import nets


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    return RoadMap.read(nets.crossing(tmp_path_factory.mktemp("crossing")))


def on_route(road: RoadMap, route: tuple[str, str], inside: bool = False) -> LaneAhead:
    """Return the lanes ahead before the crossing, or on it."""
    lane = road.lanes[f"{route[0]}_0"]
    if inside:
        link = next(x for x in lane.successors if x.to_lane.startswith(route[1]))
        return lane_ahead(road.lanes, road.lanes[link.via[-1]], 0.5, 0.0, route)
    return lane_ahead(road.lanes, lane, lane.length_m - 5.0, 0.0, route)


@pytest.mark.parametrize("inside", [False, True])
def test_by_the_rows_of_the_net(road: RoadMap, inside: bool) -> None:
    left, oncoming = on_route(road, ("WC", "CN"), inside), on_route(road, ("EC", "CW"), inside)
    minor, away = on_route(road, ("SC", "CN"), inside), on_route(road, ("WC", "CS"), inside)
    made = right_of_way(road, [left, oncoming, minor, None, away])
    assert made[0].tolist() == [False, True, False, False, False], "a left turn yields to the oncoming"
    assert made[1].tolist() == [False] * 5
    assert made[2].tolist() == [True, True, False, False, False], "the side road yields to both"
    assert not made[3].any()
    assert not made[4].any(), "a right turn off the street conflicts with none of them"


def test_a_vehicle_that_leaves_the_net_has_no_conflicts(road: RoadMap) -> None:
    leaving = lane_ahead(road.lanes, road.lanes["CE_0"], 10.0, 0.0)
    assert not right_of_way(road, [leaving, on_route(road, ("SC", "CN"))]).any()
