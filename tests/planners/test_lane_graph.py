"""The lane-graph planner in situations with a known right answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.bicycle import Limits
from advdiff_sumo.core.boxes import corners, separation
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.core.tracking import track
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.lane_graph import LaneGraphPlanner

from .scenes import CAR_M, Car, make_scene, roll

Maker = Callable[..., RoadMap]
ACROSS, ALONG = ("south_in", "north_out"), ("west_in", "east_out")
SIDES = pytest.mark.parametrize("lefthand", [False, True])


def lane_speed(out: Tracks) -> float:
    return float(out.speed_mps[0, -1])


def lateral(road: RoadMap, lane: str, out: Tracks) -> float:
    return float(road.lanes[lane].line.project(out.xy_m[0, -1], extrapolate=True)[1])


@SIDES
def test_an_empty_road_is_driven_at_the_limit_in_the_middle(crossing: Maker, lefthand: bool) -> None:
    road = crossing(lefthand=lefthand)
    out = roll(
        road, LaneGraphPlanner(), make_scene(road, [Car("west_in_0", 20.0, 5.0, d_m=0.5)], ALONG), 10.0
    )
    assert lane_speed(out) == pytest.approx(13.89, abs=0.4)
    assert lateral(road, "west_in_0", out) == pytest.approx(0.0, abs=0.1)


def test_speed_factor_is_the_share_of_the_limit(crossing: Maker) -> None:
    road = crossing()
    slow = LaneGraphPlanner(speed_factor=0.5)
    out = roll(road, slow, make_scene(road, [Car("west_in_0", 20.0, 6.0)], ALONG), 8.0)
    assert lane_speed(out) == pytest.approx(0.5 * 13.89, abs=0.3)


def test_it_stops_behind_a_standing_car(crossing: Maker) -> None:
    road = crossing()
    scene = make_scene(road, [Car("south_in_0", 50.0, 12.0), Car("south_in_0", 140.0)], ACROSS)
    out = roll(road, LaneGraphPlanner(), scene, 20.0)
    gap = float(np.hypot(*(out.xy_m[1, -1] - out.xy_m[0, -1]))) - CAR_M[0]
    assert lane_speed(out) < 0.2
    assert 1.0 < gap < 4.0
    assert np.diff(out.speed_mps[0]).min() / 0.5 > -4.0  # a comfortable stop


def test_it_overtakes_a_standing_car_in_the_other_lane(crossing: Maker) -> None:
    road = crossing()
    scene = make_scene(road, [Car("west_in_0", 30.0, 12.0), Car("west_in_0", 110.0)], ALONG)
    out = roll(road, LaneGraphPlanner(), scene, 11.0)
    assert out.xy_m[0, -1, 0] > out.xy_m[1, -1, 0] + 5.0


@pytest.mark.parametrize(("from_m", "speed_mps", "to_m"), [(175, 12, 25), (180, 12, 6), (180, 13.5, 25)])
def test_it_passes_a_standing_car_by_a_change_of_lanes_over_a_junction(
    crossing: Maker, from_m: float, speed_mps: float, to_m: float
) -> None:
    road = crossing()
    cars = [Car("west_in_0", from_m, speed_mps), Car("east_out_0", to_m)]
    out = roll(road, LaneGraphPlanner(), make_scene(road, cars, ALONG), 8.0)
    target, standing = (corners(out.xy_m[row], out.yaw_rad[row], np.array(CAR_M)) for row in (0, 1))
    assert out.xy_m[0, -1, 0] > out.xy_m[1, -1, 0] + 5.0
    assert separation(target, standing).min() > 0.2


def test_it_does_not_cut_in_front_of_a_faster_car(crossing: Maker) -> None:
    road = crossing()
    cars = [Car("west_in_0", 60.0, 8.0), Car("west_in_0", 90.0, 5.0), Car("west_in_1", 50.0, 13.9)]
    out = roll(road, LaneGraphPlanner(), make_scene(road, cars, ALONG), 1.5)
    assert abs(lateral(road, "west_in_0", out)) < 0.3


@pytest.mark.parametrize(("letter", "stops"), [("r", True), ("G", False), ("g", False)])
def test_signals(crossing: Maker, letter: str, stops: bool) -> None:
    road = crossing("traffic_light")
    scene = make_scene(road, [Car("south_in_0", 120.0, 10.0)], ACROSS, {"c": letter * 40})
    out = roll(road, LaneGraphPlanner(), scene, 12.0)
    line = road.lanes["south_in_0"].length_m
    front = (
        float(road.lanes["south_in_0"].line.project(out.xy_m[0, -1], extrapolate=True)[0]) + 0.5 * CAR_M[0]
    )
    if stops:
        assert lane_speed(out) < 0.2
        assert line - 3.0 < front < line
    else:
        assert front > line + 20.0


def test_it_stops_at_yellow_from_afar_and_passes_it_from_near(crossing: Maker) -> None:
    road = crossing("traffic_light")
    line = road.lanes["south_in_0"].length_m
    for distance, stops in ((60.0, True), (12.0, False)):
        scene = make_scene(road, [Car("south_in_0", line - distance, 12.0)], ACROSS, {"c": "y" * 40})
        out = roll(road, LaneGraphPlanner(), scene, 9.0)
        assert (lane_speed(out) < 0.5) == stops


@SIDES
def test_it_gives_way_on_the_minor_road(crossing: Maker, lefthand: bool) -> None:
    road = crossing(lefthand=lefthand)
    ego = Car("south_in_0", 150.0, 10.0)
    free = roll(road, LaneGraphPlanner(), make_scene(road, [ego], ACROSS), 8.0)
    assert free.xy_m[0, -1, 1] > 10.0
    cars = [
        ego,
        *(Car(lane, 130.0 - 22.0 * k, 12.0) for k in range(4) for lane in ("west_in_0", "east_in_0")),
    ]
    out = roll(road, LaneGraphPlanner(), make_scene(road, cars, ACROSS), 5.0)
    assert out.xy_m[0, -1, 1] + 0.5 * CAR_M[0] < -4.0
    assert lane_speed(out) < 4.0


def test_the_major_road_does_not_wait(crossing: Maker) -> None:
    road = crossing()
    cars = [Car("west_in_0", 140.0, 12.0), Car("south_in_0", 170.0, 5.0)]
    out = roll(road, LaneGraphPlanner(), make_scene(road, cars, ALONG), 3.0)
    assert lane_speed(out) > 11.0


def test_an_all_way_stop_is_a_stop_even_when_alone(crossing: Maker) -> None:
    road = crossing("allway_stop")
    out = roll(road, LaneGraphPlanner(), make_scene(road, [Car("south_in_0", 140.0, 10.0)], ACROSS), 25.0)
    assert out.speed_mps[0].min() < 0.3
    assert out.xy_m[0, -1, 1] > 20.0


def test_a_stop_far_before_the_line_counts_as_a_stop(crossing: Maker) -> None:
    road = crossing("allway_stop")
    far = LaneGraphPlanner(stop_gap_m=4.0)
    out = roll(road, far, make_scene(road, [Car("south_in_0", 140.0, 10.0)], ACROSS), 25.0)
    assert out.speed_mps[0].min() < 0.3
    assert out.xy_m[0, -1, 1] > 20.0


def test_a_turn_is_slow_enough(crossing: Maker) -> None:
    road = crossing()
    scene = make_scene(road, [Car("south_in_0", 130.0, 12.0)], ("south_in", "east_out"))
    out = roll(road, LaneGraphPlanner(), scene, 14.0)
    assert out.xy_m[0, -1, 0] > 20.0
    turn = np.abs(np.diff(np.unwrap(out.yaw_rad[0]))) / 0.5
    assert (turn * out.speed_mps[0, 1:]).max() < 4.5


@pytest.mark.parametrize("to", ["east_out", "west_out"])
@pytest.mark.parametrize(("before_m", "speed_mps"), [(0.0, 12.0), (2.0, 14.0), (6.0, 14.0)])
def test_too_fast_before_a_turn_it_brakes_hard_and_stays_on_the_road(
    crossing: Maker, before_m: float, speed_mps: float, to: str
) -> None:
    road = crossing("traffic_light")
    car = Car("south_in_0", road.lanes["south_in_0"].length_m - before_m, speed_mps)
    out = roll(road, LaneGraphPlanner(), make_scene(road, [car], ("south_in", to), {"c": "G" * 40}), 6.0)
    boxes = corners(out.xy_m[0], out.yaw_rad[0], np.array(CAR_M))
    assert road.off_road_share(boxes).max() < 0.02
    assert abs(out.xy_m[0, -1, 0]) > 10.0


def test_it_changes_to_the_lane_that_its_route_needs(crossing: Maker) -> None:
    road = crossing()
    left_turn = max(
        (link.from_lane for link in road.links.values() if link.to_lane.startswith("north_out")), key=len
    )
    other = next(x for x in road.edges["west_in"].lane_ids if x != "west_in_1")
    assert left_turn
    out = roll(
        road, LaneGraphPlanner(), make_scene(road, [Car(other, 30.0, 10.0)], ("west_in", "north_out")), 25.0
    )
    assert out.xy_m[0, -1, 1] > 15.0


def test_a_bicycle_model_can_drive_a_plan(crossing: Maker) -> None:
    road = crossing()
    scene = make_scene(road, [Car("south_in_0", 180.0, 6.0)], ("south_in", "east_out"))
    planner, rng = LaneGraphPlanner(), np.random.default_rng(0)
    plan, _ = planner.plan(road, scene, planner.start(road, scene, rng), rng)
    assert isinstance(plan, Trajectory)
    start = (scene.history.xy_m[0, -1], scene.history.yaw_rad[0, -1], scene.history.speed_mps[0, -1])
    again = track(start, (plan.xy_m, plan.yaw_rad, plan.speed_mps), np.asarray(CAR_M[0]), plan.dt_s, Limits())
    np.testing.assert_allclose(again[0], plan.xy_m, atol=1e-6)


@pytest.mark.parametrize(("replan_s", "last"), [(0.0, 4), (0.5, 4), (1.0, 9), (2.0, 19), (0.1, 1), (9.0, 19)])
def test_it_remembers_its_inputs_at_the_next_plan(crossing: Maker, replan_s: float, last: int) -> None:
    """In the entry of a bend; *last* is the last step of 0.1 s that is driven of the plan."""
    road = crossing()
    scene = make_scene(road, [Car("south_in_0", 180.0, 6.0)], ("south_in", "east_out"))
    scene = replace(scene, replan_s=replan_s)
    planner, rng = LaneGraphPlanner(), np.random.default_rng(0)
    plan, memory = planner.plan(road, scene, planner.start(road, scene, rng), rng)
    assert isinstance(plan, Trajectory)
    speed, yaw = plan.speed_mps, plan.yaw_rad
    assert len(speed) == 20
    assert memory.accel_mps2 == pytest.approx((speed[last] - speed[last - 1]) / 0.1)
    way_m = 0.1 * 0.5 * (speed[last] + speed[last - 1])
    assert memory.curvature_1pm == pytest.approx((yaw[last] - yaw[last - 1]) / way_m)


def test_off_the_map_it_stops(crossing: Maker) -> None:
    road = crossing()
    scene = make_scene(road, [Car("south_in_0", 100.0, 6.0, d_m=500.0)], ACROSS)
    assert lane_speed(roll(road, LaneGraphPlanner(), scene, 4.0)) == 0.0


def test_an_unknown_option_is_refused() -> None:
    with pytest.raises(ConfigError, match="did you mean 'time_headway_s'"):
        LaneGraphPlanner(time_headwy_s=1.0)
