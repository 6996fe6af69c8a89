"""Vehicles without a plan continue along their lanes, on a crossing of single lanes."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.planning.futures import Futures
from advdiff_sumo.traffic.planning.lane_return import return_to_lanes
from tests.sim import nets

LENGTH_M, WIDTH_M = 4.6, 1.9


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    """The street along x has priority; lanes are 3.2 m wide, the junction about 10 m."""
    return RoadMap.read(nets.crossing(tmp_path_factory.mktemp("crossing")))


def inner_lane(road: RoadMap, from_lane: str, to_lane: str) -> str:
    """Return the first lane inside the junction on the way from one lane to the other."""
    return next(link.via[0] for link in road.lanes[from_lane].successors if link.to_lane == to_lane)


def vehicles(road: RoadMap, *places: tuple[str, float, float, tuple[str, ...]], movable: int = 1) -> Scene:
    """Return vehicles (lane, s, speed, route); the first *movable* ones are handed back."""
    poses = [road.to_world(lane, s) for lane, s, _, _ in places]
    count = len(places)
    now = Tracks(
        ids=tuple(f"v{k}" for k in range(count)),
        classes=np.zeros(count, dtype=np.int64),
        size_m=np.tile([LENGTH_M, WIDTH_M], (count, 1)),
        xy_m=np.array([xy for xy, _ in poses])[:, None],
        yaw_rad=np.array([float(yaw) for _, yaw in poses])[:, None],
        speed_mps=np.array([speed for _, _, speed, _ in places])[:, None],
        valid=np.ones((count, 1), dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.5,
    )
    return Scene(now, count - 1, np.arange(count) < movable, tuple(route for *_, route in places), {})


def touching(futures: Futures) -> bool:
    boxes = corners(futures.xy_m, futures.yaw_rad, futures.size_m[:, None].repeat(futures.steps + 1, axis=1))
    return bool(overlap(boxes[0], boxes[1]).any())


LEFT_TURN = ("WC", "CN")


def in_the_turn(road: RoadMap, speed: float = 0.0) -> tuple[str, float, float, tuple[str, ...]]:
    return inner_lane(road, "WC_0", "CN_0"), 1.0, speed, LEFT_TURN


def test_a_vehicle_standing_in_a_turn_clears_the_junction(road: RoadMap) -> None:
    """From standing at 1.5 m/s² and at most about 4.5 m/s in the bend: over 15 m in 6 s."""
    futures = return_to_lanes(road, vehicles(road, in_the_turn(road)), 0.5)
    assert futures.travelled_m()[0, 1] == pytest.approx(0.5 * 1.5 * 0.5**2, abs=0.02)
    assert futures.travelled_m()[0, -1] > 15.0
    lane, *_ = road.locate_many(futures.xy_m[0, -1:], futures.yaw_rad[0, -1:])
    assert lane == ["CN_0"]


def test_it_waits_for_an_oncoming_vehicle(road: RoadMap) -> None:
    """From 20 m away at 10 m/s it crosses the turn after about 2 s, as the turning vehicle would."""
    oncoming = ("EC_0", road.lanes["EC_0"].length_m - 15.0, 10.0, ("EC", "CW"))
    scene = vehicles(road, in_the_turn(road), oncoming)
    futures = return_to_lanes(road, scene, 0.5)
    alone = return_to_lanes(road, vehicles(road, in_the_turn(road)), 0.5)
    assert futures.travelled_m()[0, 4] < alone.travelled_m()[0, 4] - 1.0
    assert futures.travelled_m()[1, 4] == pytest.approx(
        20.0, abs=0.5
    )  # a vehicle that is not adjustable is not slowed
    near = Futures(
        futures.xy_m[:, :7], futures.yaw_rad[:, :7], futures.speed_mps[:, :7], futures.size_m, futures.dt_s
    )
    assert not touching(near)


def test_it_goes_when_the_others_stand(road: RoadMap) -> None:
    waiting = ("EC_0", road.lanes["EC_0"].length_m - 3.0, 0.0, ("EC", "CW"))
    futures = return_to_lanes(road, vehicles(road, in_the_turn(road), waiting), 0.5)
    assert futures.travelled_m()[0, -1] > 15.0
    assert futures.travelled_m()[1, -1] == 0.0
    assert not touching(futures)


def test_the_plan_of_another_vehicle_is_used_instead_of_its_present_speed(road: RoadMap) -> None:
    """It waits for a vehicle that stands now and plans to cross at 8 m/s; its plan of 2 s is continued."""
    begin = road.lanes["EC_0"].length_m - 8.0
    scene = vehicles(road, in_the_turn(road), ("EC_0", begin, 0.0, ("EC", "CW")))
    now, time = scene.history, 0.5 * np.arange(1, 5)
    xy = now.xy_m[1, 0] - 8.0 * time[:, None] * (1.0, 0.0)
    plans = Tracks(
        ("v1",),
        np.zeros(1, dtype=np.int64),
        now.size_m[1:],
        xy[None],
        np.full((1, 4), np.pi),
        np.full((1, 4), 8.0),
        np.ones((1, 4), dtype=np.bool_),
        0.5,
        0.5,
    )
    futures = return_to_lanes(road, scene, 0.5, plans)
    np.testing.assert_allclose(futures.xy_m[1, 1:, 0], now.xy_m[1, 0, 0] - 4.0 * np.arange(1, 13), atol=1e-9)
    free = return_to_lanes(road, scene, 0.5)
    assert futures.travelled_m()[0, 4] < free.travelled_m()[0, 4] - 1.0


def test_two_that_are_handed_back_pass_each_other(road: RoadMap) -> None:
    """Left turns towards each other, equally far: one goes first, and both leave the junction."""
    other = inner_lane(road, "EC_0", "CS_0"), 1.0, 0.0, ("EC", "CS")
    straight = inner_lane(road, "EC_0", "CW_0"), 0.0, 0.0, ("EC", "CW")
    for second in (other, straight):
        futures = return_to_lanes(road, vehicles(road, in_the_turn(road), second, movable=2), 0.5)
        assert futures.travelled_m()[:, -1].max() > 10.0
        assert not touching(futures)


def test_a_vehicle_on_no_lane_stops(road: RoadMap) -> None:
    """At 6 m/s from 30 m beside the street: 6 m/s² or a little more, over 3 m at most."""
    scene = vehicles(road, ("WC_0", 60.0, 6.0, ("WC", "CE")))
    scene.history.xy_m[:] -= (0.0, 30.0)
    futures = return_to_lanes(road, scene, 0.5)
    assert futures.speed_mps[0, -1] == 0.0
    assert 2.5 <= futures.travelled_m()[0, -1] <= 3.0


def test_futures_are_as_long_as_required(road: RoadMap) -> None:
    scene = vehicles(road, in_the_turn(road))
    assert return_to_lanes(road, scene, 0.5).steps == 12
    assert return_to_lanes(road, scene, 9.9).steps == 20
