"""Cached and shared results of the lane-graph planner equal those computed each time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.lane_graph import LaneGraphOptions, LaneGraphPlanner
from advdiff_sumo.planners.lane_graph.chains import plausible_chains, required_changes
from advdiff_sumo.planners.lane_graph.duties import duties
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory
from advdiff_sumo.planners.lane_graph.others import others_near, ways_of
from advdiff_sumo.planners.lane_graph.path import Geometry
from advdiff_sumo.planners.lane_graph.predict import Ego, forecast
from advdiff_sumo.planners.lane_graph.profiles import Leaders, _nearest, combinations
from advdiff_sumo.planners.lane_graph.proposal_score import followers
from advdiff_sumo.planners.lane_graph.variants import TargetState, locate, variants
from tests.planners.scenes import Car, make_scene

Maker = Callable[..., RoadMap]
ROUTE = ("west_in", "east_out")
CARS = [Car("west_in_0", 150.0, 9.0), Car("west_in_0", 120.0, 11.0), Car("west_in_1", 140.0, 12.0)]
CARS += [Car("west_in_0", 185.0, 4.0), Car("south_in_0", 180.0, 5.0)]


def test_lane_changes_are_cached_by_edges(crossing: Maker) -> None:
    road = crossing()
    geometry = Geometry.of(road)
    for route in (ROUTE, ("west_in", "north_out"), ROUTE):
        assert geometry.changes(route) == required_changes(road, route)
        kept = plausible_chains(road, "west_in_0", route, 250.0, geometry.changes)
        assert kept == plausible_chains(road, "west_in_0", route, 250.0)


def test_yaw_at_equals_the_headings_of_at(crossing: Maker) -> None:
    road = crossing()
    geometry = Geometry.of(road)
    chain = plausible_chains(road, "west_in_0", ("west_in", "south_out"), 300.0)[0]
    path, s = geometry.path(chain.lanes, chain.links), np.linspace(-4.0, 330.0, 77)
    assert path.yaw_at(s).tobytes() == path.at(s, 0.4)[1].tobytes()


def test_the_nearest_leader_is_found_for_all_steps_at_once() -> None:
    rng = np.random.default_rng(3)
    rear = np.where(rng.random((3, 5, 7)) < 0.5, np.inf, rng.uniform(0.0, 50.0, (3, 5, 7)))
    speed = rng.uniform(0.0, 9.0, rear.shape)
    where, pace = _nearest(Leaders(rear, speed))
    for v, k in np.ndindex(3, 7):
        first = int(rear[v, :, k].argmin())
        assert (where[v, k], pace[v, k]) == (rear[v, first, k], speed[v, first, k])
    nobody, _ = _nearest(Leaders(rear[:, :0], speed[:, :0]))
    assert nobody.shape == (3, 7)
    assert np.isinf(nobody).all()


@pytest.mark.parametrize("kind", ["priority", "allway_stop"])
def test_shifts_within_the_lane_share_duties_and_followers(crossing: Maker, kind: str) -> None:
    road = crossing(kind)
    scene, options = make_scene(road, CARS, ROUTE), LaneGraphOptions()
    memory = LaneGraphMemory(Geometry.of(road))
    at = scene.history.xy_m[0, -1]
    state = TargetState(at, float(scene.history.yaw_rad[0, -1]), 9.0, 0.0, 0.01, 4.6, 1.8)
    place = locate(memory.geometry, state, ROUTE, memory, 0.0)
    assert place is not None
    others = others_near(scene)
    ways = ways_of(memory.geometry, scene, others)
    sides = variants(memory.geometry, state, place, memory, options)
    assert len(sides) == 4
    each = [
        duties(memory.geometry, scene, state, side, others, ways, memory, options) for side in sides
    ]  # the planner computes only those of the first one and of other lanes
    assert each[1] == each[0] == each[2]
    future = forecast(road, scene, others, ways, Ego(at, 9.0, 4.6, ()), 20)
    behind, unsafe = followers(sides, combinations(sides, each, options), state, others, future)
    for v, side in enumerate(sides):
        choice = combinations([side], [each[v]], options)
        alone, cost = followers([side], choice, state, others, future)
        rows = combinations(sides, each, options).variant == v
        np.testing.assert_array_equal(behind[rows][0], alone[0])
        assert unsafe[rows][0] == cost[0]


def test_a_plan_does_not_depend_on_the_cache(crossing: Maker) -> None:
    road = crossing()
    planner, rng = LaneGraphPlanner(), np.random.default_rng(0)
    scene = make_scene(road, CARS, ROUTE)
    used = planner.start(road, scene, rng)
    for route in (ROUTE, ("west_in", "south_out")):
        planner.plan(road, make_scene(road, CARS[::2], route), used, rng)
    plans = [
        planner.plan(road, scene, memory, rng)[0]
        for memory in (used, replace(used, geometry=Geometry.of(road)))
    ]
    first, second = (np.column_stack((p.xy_m, p.yaw_rad, p.speed_mps)) for p in plans)  # type: ignore[union-attr] # both are trajectories
    assert first.tobytes() == second.tobytes()
