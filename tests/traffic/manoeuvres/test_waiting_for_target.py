"""Vehicles that wait for a target with the right of way, on a crossing whose street along x has priority."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.waiting_for_target import waiting_lines_m
from advdiff_sumo.traffic.planning.futures import constant_velocity_futures
from tests.sim import nets
from tests.traffic.manoeuvres.scenes import LENGTH_M, scene_on

Cars = Mapping[str, tuple[tuple[str, str], float, float]]
"""Name → its route over the crossing, metres of its centre before the line, speed."""


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    return RoadMap.read(nets.crossing(tmp_path_factory.mktemp("crossing")))


def view_of(road: RoadMap, cars: Cars) -> SituationView:
    lanes = {name: road.lanes[f"{route[0]}_0"] for name, (route, _, _) in cars.items()}
    placed = {n: (lanes[n], lanes[n].length_m - away, v) for n, (_, away, v) in cars.items()}
    scene = scene_on(placed)
    return SituationView.of(road, replace(scene, routes=tuple(route for route, _, _ in cars.values())))


def lines_of(road: RoadMap, cars: Cars, view: SituationView | None = None) -> list[float]:
    """Return the waiting lines of all but the target; these vehicles keep their speed along their ways."""
    view = view or view_of(road, cars)
    rows = list(range(1, len(cars)))
    now = view.scene.history.rows(np.array(rows))
    plans = constant_velocity_futures(
        now.xy_m[:, -1], now.yaw_rad[:, -1], now.speed_mps[:, -1], now.size_m, FUTURE_STEPS, MODEL_STEP_S
    )
    return [float(line) for line in waiting_lines_m(view, rows, plans)]


TARGET = (("WC", "CE"), 30.0, 10.0)
"""It is on the priority street, and on the junction within three seconds."""
SIDE_ROAD = ("SC", "CN")


def test_a_vehicle_from_the_side_road_waits_half_a_metre_before_its_line(road: RoadMap) -> None:
    [line] = lines_of(road, {"target": TARGET, "minor": (SIDE_ROAD, 15.0, 6.0)})
    assert line == pytest.approx(15.0 - 0.5 * LENGTH_M - 0.5)


def test_a_left_turn_waits_for_an_oncoming_target(road: RoadMap) -> None:
    [line] = lines_of(road, {"target": TARGET, "turns": (("EC", "CS"), 20.0, 6.0)})
    assert line == pytest.approx(20.0 - 0.5 * LENGTH_M - 0.5)


@pytest.mark.parametrize("route", [("EC", "CW"), ("EC", "CN")])
def test_a_vehicle_that_need_not_yield_does_not_wait(road: RoadMap, route: tuple[str, str]) -> None:
    assert lines_of(road, {"target": TARGET, "other": (route, 15.0, 6.0)}) == [np.inf]


def test_a_vehicle_that_passes_in_time_does_not_wait(road: RoadMap) -> None:
    """It needs about 20 m at 12 m/s; the target has 80 m at 10 m/s."""
    cars = {"target": (("WC", "CE"), 69.0, 10.0), "minor": (SIDE_ROAD, 6.0, 12.0)}
    assert lines_of(road, cars) == [np.inf]


def test_a_vehicle_that_cannot_stop_does_not_wait(road: RoadMap) -> None:
    """From 12 m/s, 6 m require 12 m/s²."""
    assert lines_of(road, {"target": TARGET, "minor": (SIDE_ROAD, 9.0, 12.0)}) == [np.inf]


def test_a_vehicle_over_its_line_does_not_wait(road: RoadMap) -> None:
    assert lines_of(road, {"target": TARGET, "minor": (SIDE_ROAD, 1.0, 3.0)}) == [np.inf]


def test_vehicles_wait_for_a_target_that_stands_at_its_line(road: RoadMap) -> None:
    stands = {"target": (("WC", "CE"), 4.0, 0.0), "minor": (SIDE_ROAD, 4.0, 0.0)}
    assert lines_of(road, stands) == [pytest.approx(4.0 - 0.5 * LENGTH_M - 0.5)]


def test_no_vehicle_waits_for_a_target_behind_a_standing_leader(road: RoadMap) -> None:
    cars = {
        "target": (("WC", "CE"), 14.0, 0.0),
        "leader": (("WC", "CE"), 4.0, 0.0),
        "minor": (SIDE_ROAD, 4.0, 0.0),
    }
    assert lines_of(road, cars)[1] == np.inf


def test_no_vehicle_waits_for_a_standing_target_that_must_yield_itself(road: RoadMap) -> None:
    """The target turns left across an oncoming vehicle; the car from the side road must yield to the target."""
    cars = {
        "target": (("WC", "CN"), 4.0, 0.0),
        "oncoming": (("EC", "CW"), 10.0, 8.0),
        "minor": (SIDE_ROAD, 4.0, 0.0),
    }
    assert lines_of(road, cars)[1] == np.inf
    alone = {name: car for name, car in cars.items() if name != "oncoming"}
    assert lines_of(road, alone) == [pytest.approx(4.0 - 0.5 * LENGTH_M - 0.5)]


def test_without_a_rule_of_the_net_a_target_over_its_line_goes_first(tmp_path: Path) -> None:
    free = RoadMap.read(nets.crossing(tmp_path, "unregulated"))
    for away, waits in ((1.0, True), (6.0, False)):
        cars = {"target": (("WC", "CE"), away, 5.0), "minor": (SIDE_ROAD, 6.0, 5.0)}
        assert np.isfinite(lines_of(free, cars)).tolist() == [waits]


def test_vehicles_wait_for_a_target_on_the_junction_until_it_is_past_the_conflict_point(
    road: RoadMap,
) -> None:
    link = next(x for x in road.lanes["WC_0"].successors if x.to_lane.startswith("CE"))
    inner = road.lanes[link.via[-1]]
    view = view_of(road, {"target": TARGET, "minor": (SIDE_ROAD, 4.0, 0.0)})
    for place, waits in ((0.5, True), (inner.length_m, False)):
        xy, yaw = inner.line.at(place)
        history = view.scene.history
        xy_m, yaw_rad = history.xy_m.copy(), history.yaw_rad.copy()
        xy_m[0] += xy - xy_m[0, -1]
        yaw_rad[0] = yaw
        scene = replace(view.scene, history=replace(history, xy_m=xy_m, yaw_rad=yaw_rad))
        cars = {"target": TARGET, "minor": (SIDE_ROAD, 4.0, 0.0)}
        assert np.isfinite(lines_of(road, cars, SituationView.of(road, scene))).tolist() == [waits]
