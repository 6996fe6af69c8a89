"""The connection by which a vehicle enters a junction, on the shipped net of a downtown.

Its junction D4 has, from edge D5-D4.1, a lane that goes straight (to D4-D3_1) and a parallel one that turns left.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.encounter import junction_entries
from advdiff_sumo.metrics.traffic_view import TrafficView

APPROACH, LEFT = "D5-D4.1_1", ":D4_3_0"


@pytest.fixture(scope="module")
def downtown(networks: Path) -> RoadMap:
    return RoadMap.read(networks / "downtown.net.xml")


def view_of(road: RoadMap, lanes: list[str]) -> TrafficView:
    """Return the view of a car that is in the middle of each of *lanes*, one per instant."""
    poses = [road.lanes[name].line.at(0.5 * road.lanes[name].length_m) for name in lanes]
    steps = len(lanes)
    tracks = Tracks(
        ids=("car",),
        classes=np.zeros(1, dtype=np.int64),
        size_m=np.array([[4.5, 1.8]]),
        xy_m=np.array([[xy for xy, _ in poses]]),
        yaw_rad=np.array([[float(yaw) for _, yaw in poses]]),
        speed_mps=np.full((1, steps), 5.0),
        valid=np.ones((1, steps), dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.1,
    )
    return TrafficView(tracks, road, ({},) * steps, {})


@pytest.mark.parametrize(
    ("inside", "to_lane", "direction"),
    [
        (":D4_1_1", "D4-D3_1", "s"),
        (LEFT, "D4-E4_0", "l"),  # it moves over at the line
    ],
)
def test_a_lane_change_at_the_line_counts_as_the_driven_connection(
    downtown: RoadMap, inside: str, to_lane: str, direction: str
) -> None:
    [entry] = junction_entries(view_of(downtown, [APPROACH, inside, to_lane]), 0)
    assert (entry.link.to_lane, entry.link.direction) == (to_lane, direction)


def test_without_a_recorded_connection_that_of_the_lane_counts(downtown: RoadMap) -> None:
    [entry] = junction_entries(view_of(downtown, [APPROACH, ":D4_10_0"]), 0)
    assert entry.link.from_lane == APPROACH
