"""The adapters of TU Munich's planners against values worked by hand; the servers, if they are installed."""

from __future__ import annotations

import importlib
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.planner_kit.kit_road import KitLane, KitLink, KitRoad, road_of
from advdiff_sumo.planners.remote.map_message import map_message
from tests.examples.driven_twice import driven_twice

REPOSITORY = Path(__file__).parents[2]
FOLDER = REPOSITORY / "examples/tum_planners"


@pytest.fixture
def modules(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Return a function that imports the adapters' modules by name, as the servers do."""
    monkeypatch.syspath_prepend(FOLDER)
    return importlib.import_module


def lane(
    name: str, y_m: float, x_m: tuple[float, float], *links: KitLink, left: str | None = None
) -> KitLane:
    """Return a lane straight to the east, 3.2 m wide, 10 m/s."""
    x = np.linspace(*x_m, 5)
    centre = np.column_stack((x, np.full(5, y_m)))
    edge, index = name.rsplit("_", 1)
    return KitLane(
        name,
        edge,
        int(index),
        centre,
        3.2,
        10.0,
        x_m[1] - x_m[0],
        False,
        frozenset({"passenger"}),
        left,
        None,
        links,
    )


def link(from_lane: str, to_lane: str, signal: str | None = None) -> KitLink:
    return KitLink(from_lane, to_lane, (), "s", signal, 0 if signal else None, "M", "J", 0)


def street() -> KitRoad:
    """Return two lanes of 100 m; only the left one continues, after a signal, for another 100 m."""
    lanes = (
        lane("a_0", 0.0, (0.0, 100.0), left="a_1"),
        lane("a_1", 3.2, (0.0, 100.0), link("a_1", "b_0", "light")),
        lane("b_0", 3.2, (100.0, 200.0)),
    )
    return KitRoad("", False, {each.id: each for each in lanes}, (), None)


def scene(*cars: tuple[float, float, float, float], letter: str = "G") -> Scene:
    """Return cars (x, y, yaw, speed) of 4.5 by 1.8 m at two instants, 0.5 s apart; the first one is the target."""
    now = np.array(cars)
    heading = np.column_stack((np.cos(now[:, 2]), np.sin(now[:, 2])))
    before = now[:, :2] - 0.5 * now[:, 3:] * heading
    tracks = Tracks(
        ids=tuple(f"car{k}" for k in range(len(cars))),
        classes=np.zeros(len(cars), dtype=np.int64),
        size_m=np.tile([4.5, 1.8], (len(cars), 1)),
        xy_m=np.stack((before, now[:, :2]), axis=1),
        yaw_rad=np.repeat(now[:, 2:3], 2, axis=1),
        speed_mps=np.repeat(now[:, 3:], 2, axis=1),
        valid=np.ones((len(cars), 2), dtype=np.bool_),
        t0_s=-0.5,
        dt_s=0.5,
    )
    routes = (("a", "b"),) + ((),) * (len(cars) - 1)
    return Scene(tracks, 0, np.zeros(len(cars), dtype=np.bool_), routes, {"light": letter})


def test_the_line_is_that_of_the_lane_that_continues(modules: Callable[[str], ModuleType]) -> None:
    line = modules("reference_line").reference_line(street(), scene((20.0, 0.0, 0.0, 8.0)), 150.0)
    assert line.xy_m[:, 1] == pytest.approx(3.2)
    assert line.xy_m[int(line.s_m)] == pytest.approx([20.0, 3.2], abs=0.6)
    assert np.diff(line.xy_m[:, 0]) == pytest.approx(1.0)
    assert line.stop_s_m == np.inf
    assert line.desired_mps(4.5) == pytest.approx(10.0)


def test_a_red_light_bounds_the_speed(modules: Callable[[str], ModuleType]) -> None:
    line = modules("reference_line").reference_line(street(), scene((80.0, 3.2, 0.0, 8.0), letter="r"), 150.0)
    gap = 100.0 - 80.0 - 0.5 * 4.5 - 1.0  # from the front bumper to a metre before the stop line
    assert line.desired_mps(4.5) == pytest.approx(np.sqrt(2.0 * 2.0 * gap), abs=0.15)


@pytest.mark.parametrize(
    ("letter", "x_m", "stops"), [("y", 60.0, True), ("y", 95.0, False), ("g", 60.0, False)]
)
def test_a_vehicle_that_can_stop_stops_at_yellow(
    modules: Callable[[str], ModuleType], letter: str, x_m: float, stops: bool
) -> None:
    line = modules("reference_line").reference_line(
        street(), scene((x_m, 3.2, 0.0, 10.0), letter=letter), 150.0
    )
    assert bool(np.isfinite(line.stop_s_m)) is stops


def test_no_line_far_from_the_route(modules: Callable[[str], ModuleType]) -> None:
    assert modules("reference_line").reference_line(street(), scene((20.0, 40.0, 0.0, 8.0)), 150.0) is None


def test_a_bend_of_ten_metres_allows_the_root_of_twenty(modules: Callable[[str], ModuleType]) -> None:
    turn = np.arange(0.0, 15.0) / 10.0
    bend = 10.0 * np.column_stack((np.sin(turn), 1.0 - np.cos(turn)))
    assert modules("reference_line").bend_limit_mps(bend)[5:-5] == pytest.approx(
        np.sqrt(2.0 * 10.0), rel=0.01
    )


def test_others_keep_lane_offset_and_speed(modules: Callable[[str], ModuleType]) -> None:
    prediction, road = modules("prediction"), street()
    now = scene((0.0, 0.0, 0.0, 8.0), (20.0, 3.7, 0.0, 5.0), (30.0, 20.0, 1.0, 4.0), (40.0, 0.0, 0.0, 0.0))
    poses, sizes = prediction.predicted_poses(road, prediction.lane_segments(road), now, 10, 0.1)
    assert poses.shape == (3, 11, 3)
    assert sizes.tolist() == [[4.5, 1.8]] * 3
    assert poses[0, -1] == pytest.approx([25.0, 3.7, 0.0])
    assert poses[1, -1] == pytest.approx([30.0 + 4.0 * np.cos(1.0), 20.0 + 4.0 * np.sin(1.0), 1.0])
    assert poses[2, -1] == pytest.approx([40.0, 0.0, 0.0])


@given(st.tuples(*[st.floats(-1e3, 1e3)] * 2), st.floats(-7.0, 7.0), st.tuples(*[st.floats(-100, 100)] * 2))
def test_transforming_to_the_own_frame_and_back_changes_nothing(place: Any, yaw: float, point: Any) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        frame = importlib.import_module("adapter").OwnFrame(np.array(place), yaw)
    assert frame.to_world(frame.from_world(np.array(point))) == pytest.approx(np.array(point), abs=1e-9)


def test_x_of_the_own_frame_points_ahead(modules: Callable[[str], ModuleType]) -> None:
    frame = modules("adapter").OwnFrame(np.array([1.0, 2.0]), 0.5 * np.pi)
    assert frame.from_world(np.array([1.0, 5.0])) == pytest.approx([3.0, 0.0])
    assert frame.from_world(np.array([0.0, 2.0])) == pytest.approx([0.0, 1.0])  # to the left


def test_an_emergency_stop_by_hand(modules: Callable[[str], ModuleType]) -> None:
    now = scene((20.0, 2.7, 0.0, 8.0))  # half a metre to the right of the line
    line = modules("reference_line").reference_line(street(), now, 150.0)
    stop = modules("adapter").emergency_stop(now, line, 15)
    assert stop.xy_m[-1] == pytest.approx([24.0, 2.7], abs=1e-6)  # 8² / (2 · 8)
    assert stop.speed_mps[:3] == pytest.approx([7.2, 6.4, 5.6])
    assert stop.speed_mps[9:] == pytest.approx(0.0)


def test_a_plan_is_for_the_centre_and_is_remembered(modules: Callable[[str], ModuleType]) -> None:
    adapter, road, now = modules("adapter"), street(), scene((20.0, 3.2, 0.0, 8.0))
    memory = adapter.started(road)
    task = adapter.task_now(road, now, memory)
    axle = np.column_stack((0.8 * np.arange(1.0, 31.0) - adapter.REAR_AXLE_M, np.zeros(30)))
    plan, memory = adapter.planned(task, memory, axle, np.tile([0.0, 8.0, -0.5, 0.01], (30, 1)))
    assert plan.xy_m[4] == pytest.approx([24.0, 3.2])
    later = adapter.task_now(road, scene((24.0, 3.2, 0.0, 8.0)), memory)
    assert (later.accel_mps2, later.curvature_per_m) == (-0.5, 0.01)
    elsewhere = adapter.task_now(road, scene((26.0, 3.2, 0.0, 8.0)), memory)
    assert (elsewhere.accel_mps2, elsewhere.curvature_per_m) == (0.0, 0.0)


def test_lines_of_the_shipped_downtown_stay_on_the_road(modules: Callable[[str], ModuleType]) -> None:
    road_map = RoadMap.read(find_net("downtown"))
    road = road_of(map_message(road_map))
    green = {each.tls_id: "G" * 50 for lane in road.lanes.values() for each in lane.successors if each.tls_id}
    lanes = [
        each
        for _, each in sorted(road.lanes.items())
        if "passenger" in each.allows and not each.is_internal and each.successors and each.length_m > 10.0
    ]
    for start in lanes[::5]:
        step = start.centre_xy_m[1] - start.centre_xy_m[0]
        here = scene((*(start.centre_xy_m[0] + 0.5 * step), float(np.arctan2(step[1], step[0])), 5.0))
        route = (start.edge_id, road.lanes[start.successors[0].to_lane].edge_id)
        line = modules("reference_line").reference_line(
            road, replace(here, routes=(route,), signals=green), 150.0
        )
        ahead = line.xy_m[int(line.s_m) : int(line.s_m + start.length_m) + 10]
        assert road_map.covers(ahead).all(), start.id
    assert len(lanes) > 50


def installed(name: str) -> Path:
    python = REPOSITORY / f"build/tum_planners/{name}/env/bin/python"
    if not python.exists():
        pytest.skip(f"{name} is not installed: make planners")
    return python


@pytest.mark.slow
@pytest.mark.parametrize("name", ["frenetix", pytest.param("reactive", marks=pytest.mark.nightly)])
def test_the_planners_drive_and_repeat_themselves(name: str, tmp_path: Path) -> None:
    target = f"exec:{installed(name)} {FOLDER / name}_server.py"
    driven = driven_twice(target, 6, "--set", "target_options.plan_timeout_s=60", folder=tmp_path)
    assert driven.first == driven.again
    assert driven.unsound(5.0) == []


def test_setup_says_which_planners_there_are() -> None:
    done = subprocess.run([FOLDER / "setup.sh", "apollo"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "reactive|frenetix" in done.stderr
