"""The exit lane of a vehicle on a junction along whose heading no lane leads."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.planning.lane_following import follow
from advdiff_sumo.traffic.planning.lanes_ahead import lanes_ahead
from advdiff_sumo.traffic.planning.way_out import way_out


@pytest.fixture(scope="module")
def askew(downtown: RoadMap) -> tuple[np.ndarray, float]:
    """Return a position on a junction and a heading that differs by over 1.2 rad from every lane there."""
    for lane in (x for x in downtown.lanes.values() if x.is_internal and x.is_drivable):
        xy, along = lane.line.at(2.0)
        for turn in (1.4, 1.8):
            yaw = float(along) + turn
            on_none = lanes_ahead(downtown, xy[None], np.array([yaw]), [()]) == [None]
            if on_none and way_out(downtown, xy, yaw) is not None:
                return xy, yaw
    pytest.fail("every heading on every junction has a lane")


def test_a_vehicle_across_all_lanes_drives_to_the_beginning_of_an_exit_lane(
    downtown: RoadMap, askew: tuple[np.ndarray, float]
) -> None:
    xy, yaw = askew
    lane = way_out(downtown, xy, yaw)
    assert lane is not None
    assert lane.s_m <= 0.0
    assert not lane.lanes[0].is_internal
    arrive, _, speed = follow([lane], xy[None], np.array([yaw]), np.zeros(1), np.array([4.6]), 12, 0.5)
    s, left = lane.lanes[0].line.project(arrive[0, -1])
    assert s > 0.0
    assert abs(left) < 0.5 * lane.lanes[0].width_m
    assert speed[0, -1] > 2.0


def test_there_is_no_exit_lane_off_junctions(downtown: RoadMap) -> None:
    lane = max((x for x in downtown.lanes.values() if not x.is_internal), key=lambda x: (x.length_m, x.id))
    xy, yaw = lane.line.at(0.5 * lane.length_m)
    assert way_out(downtown, xy, float(yaw)) is None
