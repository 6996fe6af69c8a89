"""The reference drivers of UN R157 as targets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from advdiff_sumo.core.boxes import corners, overlap
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_check import check_planner
from advdiff_sumo.planners.planner_protocol import Planner
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.planners.reference import CarefulPlanner

from .scenes import Car, make_scene, roll

NAMES = ("careful", "reg157", "rss", "fsm")
ROUTE = ("west_in", "east_out")


def planned(name: str, road: RoadMap, scene: Scene) -> Trajectory:
    planner = make_target(name, {})
    assert isinstance(planner, Planner)
    rng = np.random.default_rng(0)
    plan, _ = planner.plan(road, scene, planner.start(road, scene, rng), rng)
    assert isinstance(plan, Trajectory)
    return plan


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["priority", "traffic_light"])
def test_they_keep_the_contract(crossing: Callable[..., RoadMap], name: str, kind: str) -> None:
    road = crossing(kind, False)
    cars = [Car("south_in_0", 150.0, 8.0), Car("west_in_0", 150.0, 12.0), Car("east_in_1", 120.0, 12.0)]
    scene = make_scene(
        road, cars, ("south_in", "north_out"), {"c": "G" * 40} if kind == "traffic_light" else {}
    )
    planner = make_target(name, {})
    assert isinstance(planner, Planner)
    assert check_planner(planner, road, scene) == []


@pytest.mark.parametrize("name", NAMES)
def test_on_a_free_road_they_drive_as_the_lane_graph_planner_does(
    crossing: Callable[..., RoadMap], name: str
) -> None:
    road = crossing()
    scene = make_scene(road, [Car("west_in_0", 40.0, 10.0)], ROUTE)
    reference, normal = planned(name, road, scene), planned("lane_graph", road, scene)
    np.testing.assert_array_equal(reference.xy_m, normal.xy_m)


def test_the_human_driver_brakes_after_its_delay(crossing: Callable[..., RoadMap]) -> None:
    road = crossing()
    # 9.4 m bumper to bumper at 10 m/s: 0.94 s; the delay of 0.75 s takes eight steps of the plan
    scene = make_scene(road, [Car("west_in_0", 40.0, 10.0), Car("west_in_0", 54.0, 0.0)], ROUTE)
    planner = CarefulPlanner(time_headway_s=0.1, min_gap_m=0.5, decel_mps2=6.0)
    rng = np.random.default_rng(0)
    memory = planner.start(road, scene, rng)
    _, after = planner.plan(road, scene, memory, rng)
    assert after.alarmed_s == scene.time_s
    assert float(after.at(0.5)[0].delay_left_s) == pytest.approx(0.75 - 5 * 0.1)
    assert float(memory.at(0.0)[0].delay_left_s) == 0.75


def test_rss_brakes_where_its_gap_is_too_short(crossing: Callable[..., RoadMap]) -> None:
    road = crossing()
    # 12 m/s behind 10 m/s: 9 + 0.84 + 14.25²/12 − 100/12 = 18.4 m are needed, the gap is 13.4 m
    scene = make_scene(road, [Car("west_in_0", 40.0, 12.0), Car("west_in_0", 58.0, 10.0)], ROUTE)
    rss, careful = planned("rss", road, scene), planned("careful", road, scene)
    assert rss.speed_mps[-1] < careful.speed_mps[-1] - 2.0


def test_they_do_not_run_into_a_standing_car(crossing: Callable[..., RoadMap]) -> None:
    road = crossing()
    scene = make_scene(road, [Car("west_in_0", 40.0, 12.0), Car("west_in_0", 110.0, 0.0)], ROUTE)
    for name in NAMES:
        planner = make_target(name, {"lane_changes": False})
        assert isinstance(planner, Planner)
        tracks = roll(road, planner, scene, 6.0)
        own, other = (corners(tracks.xy_m[i], tracks.yaw_rad[i], tracks.size_m[[i]]) for i in (0, 1))
        assert not overlap(own, other).any(), name


def test_a_misspelt_option_is_refused() -> None:
    with pytest.raises(ConfigError, match="brake_mps2"):
        make_target("careful", {"brake_mps": 3.0})
