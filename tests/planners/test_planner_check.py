"""The contract checker finds each breach, and the built-in planner passes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.plan import Controls, Trajectory
from advdiff_sumo.core.plan_form import plan_arrays
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_check import check_planner, motion_problems, planning_times_s
from advdiff_sumo.planners.planner_registry import make_target

from .scenes import Car, make_scene

ROUTE = ("west_in", "east_out")


class Broken:
    """Returns what the given function makes."""

    def __init__(self, make: Callable[[Scene, int, np.random.Generator], Any]) -> None:
        self.make, self.calls = make, 0

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Remember nothing."""

    def plan(
        self,
        road: RoadMap,
        scene: Scene,
        memory: Any,
        rng: np.random.Generator,
    ) -> Any:
        self.calls += 1
        return self.make(scene, self.calls, rng)


def straight(scene: Scene, steps: int = 5, dt_s: float = 0.1) -> Trajectory:
    state = scene.history
    speed = float(state.speed_mps[0, -1])
    along = speed * dt_s * np.arange(1, steps + 1)
    xy = state.xy_m[0, -1] + np.stack((along, np.zeros(steps)), -1)
    return Trajectory(xy, np.full(steps, state.yaw_rad[0, -1]), np.full(steps, speed), dt_s)


def spoil(scene: Scene) -> Trajectory:
    plan = straight(scene)
    scene.history.speed_mps[:] += 1.0
    return plan


def with_values(plan: Trajectory, **values: Any) -> Trajectory:
    parts: dict[str, Any] = {
        "xy_m": plan.xy_m,
        "yaw_rad": plan.yaw_rad,
        "speed_mps": plan.speed_mps,
        "dt_s": plan.dt_s,
    }
    return Trajectory(**(parts | values))


@pytest.fixture
def scene(crossing: Callable[..., RoadMap]) -> Scene:
    return make_scene(crossing(), [Car("west_in_0", 50.0, 10.0), Car("west_in_1", 60.0, 8.0)], ROUTE)


def test_a_planner_that_keeps_the_contract(crossing: Callable[..., RoadMap], scene: Scene) -> None:
    assert check_planner(Broken(lambda s, _n, _r: (straight(s), None)), crossing(), scene) == []


def test_a_planner_may_write_into_its_scene(crossing: Callable[..., RoadMap], scene: Scene) -> None:
    before = scene.history.speed_mps.tobytes()
    assert check_planner(Broken(lambda s, _n, _r: (spoil(s), None)), crossing(), scene) == []
    assert scene.history.speed_mps.tobytes() == before


def test_plans_in_float32_keep_the_contract(crossing: Callable[..., RoadMap], scene: Scene) -> None:
    def single(plan: Trajectory) -> Trajectory:
        return with_values(
            plan, **{name: getattr(plan, name).astype(np.float32) for name in plan_arrays(plan)}
        )

    assert check_planner(Broken(lambda s, _n, _r: (single(straight(s)), None)), crossing(), scene) == []


CASES: list[tuple[Callable[[Scene, int, np.random.Generator], Any], str]] = [
    (lambda s, _n, _r: straight(s), "not (plan, memory)"),
    (lambda _s, _n, _r: ("left", None), "returned a str"),
    (lambda s, _n, _r: (straight(s, steps=4), None), "lasts 0.4 s"),
    (lambda s, _n, _r: (with_values(straight(s), yaw_rad=np.full(5, np.nan)), None), "not finite"),
    (lambda s, _n, _r: (with_values(straight(s), speed_mps=np.zeros(4)), None), "shape"),
    (lambda s, _n, _r: (with_values(straight(s), xy_m=straight(s).xy_m + 5.0), None), "step 0 moves farther"),
    (lambda s, _n, _r: (with_values(straight(s), xy_m=straight(s).xy_m - [1.4, 0.0]), None), "less far"),
    (lambda s, _n, _r: (with_values(straight(s), xy_m=straight(s).xy_m - [1.0, 0.0]), None), "less far"),
    (lambda s, _n, _r: (with_values(straight(s), speed_mps=np.zeros(5)), None), "brakes by more"),
    (lambda s, _n, _r: (with_values(straight(s), yaw_rad=np.full(5, 2.0)), None), "turns faster"),
    (
        lambda s, _n, _r: (with_values(straight(s), yaw_rad=np.full(5, 2.0)), None),
        "step 0 moves in another direction than it heads (yaw in radians)",
    ),
    (
        lambda s, n, _r: (with_values(straight(s), speed_mps=np.full(5, 10.0 + 0.01 * n)), None),
        "two different plans",
    ),
    (lambda _s, _n, _r: (Controls(np.full(5, 9.0), np.zeros(5), 0.1), None), "accelerates by 9.0"),
    (lambda _s, _n, _r: (Controls(np.zeros(5), np.full(5, 1.0), 0.1), None), "steers by 1.00 rad"),
    (lambda _s, _n, _r: 1 // 0, "raised ZeroDivisionError"),
]


@pytest.mark.parametrize(("make", "words"), CASES, ids=[words for _, words in CASES])
def test_a_broken_contract_is_named(
    crossing: Callable[..., RoadMap],
    scene: Scene,
    make: Callable[[Scene, int, np.random.Generator], Any],
    words: str,
) -> None:
    assert words in "; ".join(check_planner(Broken(make), crossing(), scene))


def test_a_plan_may_reverse(scene: Scene) -> None:
    states = scene.history
    back = replace(scene, history=replace(states, speed_mps=np.full_like(states.speed_mps, -2.0)))
    assert motion_problems(straight(back), back) == []


def test_a_plan_may_bend(scene: Scene) -> None:
    turn_rad = 1.4  # in half a second at 10 m/s: the chord is 4.60 m, 8 % shorter than the arc of 5 m
    chord_m = 5.0 * np.sin(turn_rad / 2.0) / (turn_rad / 2.0)
    way_m = chord_m * np.array([[np.cos(turn_rad / 2.0), np.sin(turn_rad / 2.0)]])
    xy_m = scene.history.xy_m[scene.target, -1] + way_m
    assert motion_problems(Trajectory(xy_m, np.array([turn_rad]), np.array([10.0]), 0.5), scene) == []


class WritesIntoMap(Broken):
    """Transforms a lane into its own frame, in place."""

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> Any:
        points = road.lanes["west_in_0"].centre_xy_m
        points -= scene.history.xy_m[0, -1]
        return super().plan(road, scene, memory, rng)


def test_writing_into_the_shared_map_is_reported(crossing: Callable[..., RoadMap], scene: Scene) -> None:
    road = crossing()
    before = road.lanes["west_in_0"].centre_xy_m.tobytes()
    told = check_planner(WritesIntoMap(lambda s, _n, _r: (straight(s), None)), road, scene)
    assert "read-only" in "; ".join(told)
    assert road.lanes["west_in_0"].centre_xy_m.tobytes() == before


def test_missing_methods(crossing: Callable[..., RoadMap], scene: Scene) -> None:
    assert check_planner(object(), crossing(), scene) == [  # type: ignore[arg-type] # on purpose
        "it has no method start",
        "it has no method plan",
    ]


@pytest.mark.parametrize("kind", ["priority", "allway_stop", "right_before_left", "traffic_light"])
@pytest.mark.parametrize("lefthand", [False, True])
def test_lane_graph_keeps_the_contract(crossing: Callable[..., RoadMap], kind: str, lefthand: bool) -> None:
    road = crossing(kind, lefthand)
    cars = [Car("south_in_0", 150.0, 8.0), Car("west_in_0", 150.0, 12.0), Car("east_in_1", 120.0, 12.0)]
    signals = {"c": "G" * 40} if kind == "traffic_light" else {}
    scene = make_scene(road, cars, ("south_in", "north_out"), signals)
    planner = make_target("lane_graph", {})
    assert check_planner(planner, road, scene) == []  # type: ignore[arg-type] # a Planner
    assert planning_times_s(planner, road, scene, 3).shape == (3,)  # type: ignore[arg-type] # a Planner
