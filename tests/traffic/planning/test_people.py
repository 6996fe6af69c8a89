"""Moved vehicles do not hit pedestrians: predicted positions and clearance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.traffic.planning.braking import SIDE_M, brake
from advdiff_sumo.traffic.planning.futures import Futures, constant_velocity_futures
from advdiff_sumo.traffic.planning.people import PEOPLE_SIDE_M, go_straight, velocities

T, DT = 12, 0.5


def walks(xy_m: list[tuple[float, float]], valid: list[bool]) -> Tracks:
    """Return a pedestrian at 2 Hz with heading east and speed 1 m/s, whatever its positions."""
    steps = len(xy_m)
    return Tracks(
        ids=("p",),
        classes=np.array([AgentClass.PEDESTRIAN]),
        size_m=np.array([[0.6, 0.6]]),
        xy_m=np.array(xy_m)[None],
        yaw_rad=np.zeros((1, steps)),
        speed_mps=np.ones((1, steps)),
        valid=np.array(valid)[None],
        t0_s=0.0,
        dt_s=DT,
    )


@pytest.mark.parametrize(
    ("valid", "velocity"),
    [
        ([True, True, True], (0.0, 1.5)),  # 1.5 m north in the last second
        ([False, True, True], (0.0, 2.0)),  # of which 1 m in its last half
        ([True, False, True], (1.0, 0.0)),  # no known past: along its heading
    ],
)
def test_pedestrians_keep_their_mean_velocity(valid: list[bool], velocity: tuple[float, float]) -> None:
    assert velocities(walks([(0, 0), (0, 0.5), (0, 1.5)], valid))[0].tolist() == pytest.approx(velocity)


def street(beside_m: float, walks_mps: float, faces: float = 0.0) -> Futures:
    """Return a car at 8 m/s along x, and a pedestrian 24 m ahead, *beside_m* to its left, who walks to the right."""
    futures = constant_velocity_futures(
        np.array([[0.0, 0.0], [24.0, beside_m]]),
        np.array([0.0, faces]),
        np.array([8.0, 0.0]),
        np.array([[4.6, 1.9], [0.6, 0.6]]),
        T,
        DT,
    )
    go_straight(futures, np.array([False, True]), np.array([[0.0, 0.0], [0.0, -walks_mps]]))
    return futures


def braked(futures: Futures, side_m: float = PEOPLE_SIDE_M) -> bool:
    """Return whether the car brakes, and check that it then does not touch the pedestrian."""
    adjustable, may_brake_for = np.array([True, False]), ~np.eye(2, dtype=np.bool_)
    made = brake(futures, adjustable, may_brake_for, np.full(2, np.inf), np.array([SIDE_M, side_m]))
    assert not made.unsolved.any()
    gap = np.abs(made.futures.xy_m[0] - made.futures.xy_m[1]) - 0.5 * (made.futures.size_m[0] + 0.6)
    assert (gap.max(axis=1) > 0.0).all()
    return bool(made.braked[0])


@pytest.mark.parametrize(
    ("beside_m", "walks_mps", "gives_way"),
    [
        (3.0, 1.0, True),  # in the path after 3 s, when the car would be there
        (3.0, 0.0, False),  # stands at the kerb
        (30.0, 1.0, False),  # far from the road
        (0.0, 0.0, True),  # stands in the path
    ],
)
def test_a_car_brakes_for_a_pedestrian_who_walks_into_its_path(
    beside_m: float, walks_mps: float, gives_way: bool
) -> None:
    """Whatever the heading: here along the street, while the pedestrian walks across it."""
    assert braked(street(beside_m, walks_mps)) == gives_way


def test_pedestrians_get_more_clearance_than_cars() -> None:
    """0.95 + 0.3 m and 0.2 m more: the car would pass another car, but not a pedestrian."""
    futures = street(1.45, 0.0)
    assert not braked(futures, SIDE_M)
    assert braked(futures)


def test_only_the_given_rows_go_straight() -> None:
    futures = street(3.0, 1.0)
    before = replace(futures, xy_m=futures.xy_m.copy())
    go_straight(futures, np.array([False, False]), np.ones((2, 2)))
    np.testing.assert_array_equal(futures.xy_m, before.xy_m)
