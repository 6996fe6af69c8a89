"""Hard scenes match their names, and the ordinary scene is left unchanged."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.hard_scenes import hard_scenes, hard_scenes_of_traffic
from advdiff_sumo.planners.planner_check import carries_over
from advdiff_sumo.planners.planner_registry import make_target

from .scenes import Car, make_scene


def test_each_scene_matches_its_name(crossing: Callable[..., RoadMap]) -> None:
    scene = make_scene(
        crossing(), [Car("west_in_0", 80.0, 9.0), Car("east_in_0", 80.0, 8.0)], ("west_in", "east_out")
    )
    before = scene.history.xy_m.tobytes(), scene.history.speed_mps.tobytes()
    made = hard_scenes(scene)
    assert made["nobody else is there"].history.ids == ("car0",)
    assert not made["it stands"].history.speed_mps[0].any()
    assert made["no route is known"].routes == ((), ())
    past = made["nothing is known of the past"].history
    assert past.valid[:, -1].all()
    assert not past.valid[:, :-1].any()
    assert np.isnan(past.xy_m[:, :-1]).all()
    assert not crossing().covers(made["it is off the road"].history.xy_m[0, -1])
    wall = made["somebody stands right before it"].history
    assert np.hypot(*(wall.xy_m[1, -1] - wall.xy_m[0, -1])) == pytest.approx(4.6 + 8.0)
    assert (scene.history.xy_m.tobytes(), scene.history.speed_mps.tobytes()) == before


def test_without_others_no_scene_is_blocked(crossing: Callable[..., RoadMap]) -> None:
    scene = make_scene(crossing(), [Car("west_in_0", 80.0, 9.0)], ("west_in", "east_out"))
    assert "somebody stands right before it" not in hard_scenes(scene)


def test_policies_get_two_more_scenes(crossing: Callable[..., RoadMap]) -> None:
    cars = [Car("west_in_0", 80.0, 9.0), Car("east_in_0", 80.0, 8.0), Car("south_in_0", 90.0, 7.0)]
    scene = make_scene(crossing(), cars, ("west_in", "east_out"))
    scene.movable[1:] = True
    made = hard_scenes_of_traffic(scene)
    assert {name.replace("the target", "it") for name in made} >= hard_scenes(scene).keys()
    assert not made["nobody may be moved"].movable.any()
    crowd = made["120 road users are there"]
    assert (crowd.history.agents, len(crowd.routes), int(crowd.movable.sum())) == (120, 120, 119)
    assert crowd.history.index["car1 again 1"] == 3
    apart_m = np.hypot(*(crowd.history.xy_m[3, -1] - scene.history.xy_m[1, -1]))
    assert apart_m == pytest.approx(4.6 + 8.0)
    assert "120 road users are there" not in hard_scenes_of_traffic(made["nobody else is there"])


def test_a_planner_that_keeps_state_between_scenes_is_noticed(crossing: Callable[..., RoadMap]) -> None:
    road = crossing()
    scene = make_scene(road, [Car("west_in_0", 80.0, 9.0)], ("west_in", "east_out"))
    honest = make_target("lane_graph", {})

    class Growing:
        """Slows down a little more with every third plan."""

        count = 0

        def start(self, *words: object) -> object:
            return honest.start(*words)  # type: ignore[union-attr] # lane_graph is a planner

        def plan(self, road: RoadMap, scene: object, memory: object, rng: np.random.Generator) -> object:
            self.count += 1
            plan, memory = honest.plan(road, scene, memory, rng)  # type: ignore[union-attr, arg-type] # as above
            plan.speed_mps[-1] -= 0.001 * (self.count // 3)  # type: ignore[union-attr] # a trajectory
            return plan, memory

    assert not carries_over(honest, road, [scene, scene])  # type: ignore[arg-type] # as above
    assert carries_over(Growing(), road, [scene, scene])  # type: ignore[arg-type] # returns object
