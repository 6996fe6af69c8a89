"""The parts of the lane-graph planner, against values worked out by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.lane_graph.chains import detour, plausible_chains, required_changes, route_chain
from advdiff_sumo.planners.lane_graph.conflicts import conflict_zone
from advdiff_sumo.planners.lane_graph.lane_graph_options import LaneGraphOptions
from advdiff_sumo.planners.lane_graph.memory import LaneGraphMemory
from advdiff_sumo.planners.lane_graph.others import others_near, ways_of
from advdiff_sumo.planners.lane_graph.path import Geometry, PathStack, ReferencePath, _smoothed
from advdiff_sumo.planners.lane_graph.predict import Ego, forecast
from advdiff_sumo.planners.lane_graph.proposal_score import _time_at
from advdiff_sumo.planners.lane_graph.rules import Duty, may_go, rule_at
from advdiff_sumo.planners.lane_graph.variants import TargetState, Variant, locate, variants

from .scenes import CAR_M, Car, make_scene

Maker = Callable[..., RoadMap]


def path_of(road: RoadMap, start: str, route: tuple[str, ...]) -> ReferencePath:
    chain = route_chain(road, start, route, required_changes(road, route), 300.0)
    return Geometry.of(road).path(chain.lanes, chain.links)


def link_between(road: RoadMap, origin: str, target: str) -> tuple[str, str]:
    return next(key for key in road.links if key[0].startswith(origin) and key[1].startswith(target))


@pytest.mark.parametrize("lefthand", [False, True])
def test_changes_are_counted_towards_the_turn(crossing: Maker, lefthand: bool) -> None:
    road = crossing(lefthand=lefthand)
    for goal in ("north_out", "south_out"):
        needed = required_changes(road, ("west_in", goal))
        serving = {a for a, b in road.links if a.startswith("west_in") and b.startswith(goal)}
        for lane in road.edges["west_in"].lane_ids:
            changes = needed[0, lane][1]
            assert (changes == 0) == (lane in serving)
            if changes:
                assert (road.lanes[lane].left_id if changes > 0 else road.lanes[lane].right_id) in serving


def test_a_chain_follows_the_route_over_the_junction(crossing: Maker) -> None:
    road = crossing()
    chain = route_chain(road, "south_in_0", ("south_in", "north_out"), {}, 300.0)
    assert chain.lanes[0] == "south_in_0"
    assert chain.lanes[-1] == "north_out_0"
    assert chain.follows_route
    assert [link.to_lane for link in chain.links] == ["north_out_0"]


def test_a_lane_that_does_not_serve_the_route_ends(crossing: Maker) -> None:
    road = crossing()
    route = ("west_in", "north_out")
    needed = required_changes(road, route)
    wrong = next(lane for lane in road.edges["west_in"].lane_ids if needed[0, lane][1])
    chain = route_chain(road, wrong, route, needed, 300.0)
    assert not chain.follows_route
    assert chain.lanes == (wrong,)


def test_without_a_route_every_connection_is_plausible(crossing: Maker) -> None:
    road = crossing()
    ends = {
        chain.links[0].to_lane.rsplit("_", 1)[0] for chain in plausible_chains(road, "south_in_0", (), 250.0)
    }
    assert ends == {"west_out", "north_out", "east_out"}
    assert len(plausible_chains(road, "south_in_0", ("south_in", "north_out"), 250.0)) == 1
    assert plausible_chains(road, "south_in_0", (), 20.0)[0].lanes == ("south_in_0",)


def test_a_detour_takes_a_connection_of_the_lane_itself(crossing: Maker) -> None:
    road = crossing()
    way = detour(road, "south_in_0", "east_out")
    assert way == ("south_in", "east_out")
    assert detour(road, "east_out_0", "west_out") == ()


@pytest.mark.parametrize(
    ("letter", "duty", "free"),
    [
        ("r", Duty.STOP, False),
        ("u", Duty.STOP, False),
        ("y", Duty.CLEAR, False),
        ("G", Duty.GO, True),
        ("O", Duty.GO, True),
        ("s", Duty.STOP_THEN_YIELD, True),
    ],
)
def test_letters_of_signals(crossing: Maker, letter: str, duty: Duty, free: bool) -> None:
    road = crossing("traffic_light")
    link = road.links[link_between(road, "south_in", "north_out")]
    assert rule_at(road, link, {"c": letter * 40}).duty is duty
    assert may_go(link, {"c": letter * 40}) is free


def test_right_of_way_without_signals(crossing: Maker) -> None:
    road = crossing()
    minor = rule_at(road, road.links[link_between(road, "south_in", "north_out")], {})
    major = rule_at(road, road.links[link_between(road, "west_in_0", "east_out")], {})
    assert minor.duty is Duty.YIELD
    assert major.duty is Duty.GO
    road = crossing("allway_stop")
    stop = rule_at(road, road.links[link_between(road, "south_in", "north_out")], {})
    assert stop.duty is Duty.STOP_THEN_YIELD
    assert stop.in_turn


def test_crossing_ways_meet_and_parallel_ones_do_not(crossing: Maker) -> None:
    road = crossing()
    geometry = Geometry.of(road)
    up = road.links[link_between(road, "south_in", "north_out")]
    across = road.links[link_between(road, "west_in_0", "east_out")]
    down = road.links[link_between(road, "north_in", "south_out")]
    zone = conflict_zone(geometry, up, across)
    assert zone is not None
    assert not zone.merges
    middle = 0.5 * sum(zone.own_m)
    where = path_of(road, up.from_lane, ("south_in", "north_out"))
    crossing_y = where.at(np.asarray(where.stop_m[0] + middle))[0][1]
    assert crossing_y == pytest.approx(road.lanes[across.from_lane].centre_xy_m[-1, 1], abs=0.6)
    assert conflict_zone(geometry, up, down) is None


@pytest.mark.parametrize(("north", "least_m", "most_m"), [((0, 200), 0.0, 0.0), ((180, 30), 2.0, 4.0)])
def test_in_a_tight_turn_the_front_meets_the_other_lane_sooner(
    crossing: Maker, north: tuple[int, int], least_m: float, most_m: float
) -> None:
    road = crossing(north=north)
    left = road.links[link_between(road, "north_in", "east_out")]
    across = road.links[link_between(road, "west_in_1", "east_out")]
    zone = conflict_zone(Geometry.of(road), left, across)
    assert zone is not None
    centres = [
        concatenate([road.lanes[lane].line for lane in (*link.via, link.to_lane)]) for link in (left, across)
    ]
    own, other = (line.at(np.arange(0.0, 40.0, 0.5))[0] for line in centres)
    distances_m = np.hypot(*(own[:, None] - other[None]).transpose(2, 0, 1)).min(axis=1)
    sooner_m = 0.5 * float((distances_m < 2.6).argmax()) - zone.own_m[0]
    assert least_m <= sooner_m <= most_m


@pytest.mark.parametrize(
    "route", [("south_in", "north_out"), ("south_in", "east_out"), ("south_in", "west_out")]
)
def test_projection_inverts_at(crossing: Maker, route: tuple[str, ...]) -> None:
    path = path_of(crossing(), "south_in_0", route)
    s, d = np.meshgrid(np.linspace(-5.0, path.length_m + 5.0, 60), [-1.0, 0.0, 1.0])
    got_s, got_d = path.project(path.at(s, d)[0])
    np.testing.assert_allclose(got_s, s, atol=0.25)
    np.testing.assert_allclose(got_d, d, atol=0.1)


def test_a_path_stack_equals_its_single_paths(crossing: Maker) -> None:
    road = crossing()
    paths = [path_of(road, "south_in_0", ("south_in", goal)) for goal in ("north_out", "east_out")]
    stack, s = PathStack(paths), np.array([[10.0, 199.3], [3.7, 205.0]])
    xy, yaw = stack.at(s, np.full_like(s, 0.7))
    points = np.array([[3.0, -50.0], [30.0, 5.0]])
    for n, path in enumerate(paths):
        one_xy, one_yaw = path.at(s[n], 0.7)
        np.testing.assert_allclose(xy[n], one_xy)
        np.testing.assert_allclose(yaw[n], one_yaw)
        np.testing.assert_allclose(stack.project(points)[0][n], path.project(points)[0])
        np.testing.assert_allclose(stack.project(points)[1][n], path.project(points)[1])


def test_a_blend_starts_where_the_target_is_and_ends_on_its_aim(crossing: Maker) -> None:
    road = crossing()
    route = ("south_in", "north_out")
    chain = route_chain(road, "south_in_0", route, {}, 100.0)
    path = Geometry.of(road).path(chain.lanes, chain.links)
    variant = Variant(chain, path, 1, 10.0, -3.2, 0.05, 0.0, 0.0, 40.0)
    d, slope = variant.lateral(np.array([10.0, 10.1, 30.0, 50.0, 60.0]))
    assert d[0] == pytest.approx(-3.2)
    assert slope[0] == pytest.approx(0.05)
    assert (d[1] - d[0]) / 0.1 == pytest.approx(0.05, abs=1e-3)
    assert d[3:] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert slope[3:] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.array_equal(
        variant.offset(np.linspace(0.0, 60.0, 13)), variant.lateral(np.linspace(0.0, 60.0, 13))[0]
    )


def test_before_a_corner_too_tight_for_a_car_the_line_swings_out() -> None:
    raw = Polyline.of(np.array([[0.0, 0.0], [40.0, 0.0], [40.0, -40.0]]))
    xy, yaw, curvature = _smoothed(raw, 81)
    assert np.abs(curvature).max() <= 0.17
    assert yaw[-1] == pytest.approx(-np.pi / 2)
    gap = np.hypot(*(xy - [40.0, 0.0]).T).min()
    assert 1.5 < gap < 2.5  # a circle of 6 m between the legs passes the corner at 6 (√2 − 1) = 2.5 m
    assert 0.2 < xy[:, 1].max() < 0.5  # a car of 1.9 m stays in its lane of 3.2 m
    assert xy[:, 0].max() < 40.2  # and leaves the corner on its line
    np.testing.assert_allclose(xy[:5, 1], 0.0, atol=1e-9)  # far from the corner nothing moves


def test_a_target_that_swung_wide_returns_to_its_previous_path(crossing: Maker) -> None:
    road = crossing()
    route = ("south_in", "east_out")
    chain = route_chain(road, "south_in_0", route, required_changes(road, route), 300.0)
    memory = LaneGraphMemory(Geometry.of(road), chain.lanes, chain.links, route)
    link = chain.links[0]
    wide = road.lanes[link.to_lane].line.at(np.asarray(2.0))[0] + [0.0, 8.0]  # on a lane of the oncoming
    state = TargetState(wide, 0.5 * np.pi, 4.0, 0.0, 0.0, 5.0, 1.8)
    place = locate(memory.geometry, state, route, memory, 0.0)
    assert place is not None
    assert road.lanes[place.lane_id].edge_id == "east_out"
    fresh = locate(memory.geometry, state, route, LaneGraphMemory(memory.geometry), 0.0)
    assert fresh is not None
    assert (
        road.lanes[fresh.lane_id].edge_id != "east_out"
    )  # from the lane at its pose it would drive elsewhere


@pytest.mark.parametrize("lefthand", [False, True])
def test_a_lane_change_underway_continues_over_a_junction(crossing: Maker, lefthand: bool) -> None:
    road, route = crossing(lefthand=lefthand), ("west_in", "east_out")
    geometry, options = Geometry.of(road), LaneGraphOptions()
    by_lane = {x.from_lane: x for x in road.links.values() if x.to_lane.startswith("east_out")}
    over = by_lane["west_in_0"].via[0]
    onto = by_lane["west_in_1"].via[0]
    xy, yaw = road.to_world(over, 1.0, 0.0)
    state = TargetState(np.asarray(xy), float(yaw), 10.0, 0.0, 0.0, *CAR_M)
    none_chosen = LaneGraphMemory(geometry, route=route)
    chain = route_chain(road, "west_in_1", route, required_changes(road, route), 300.0)
    underway = LaneGraphMemory(geometry, chain.lanes, chain.links, route)
    for memory, sides in ((none_chosen, {0}), (underway, {0, -1 if lefthand else 1})):
        place = locate(geometry, state, route, memory, 0.0)
        assert place is not None
        assert place.lane_id == over
        choices = variants(geometry, state, place, memory, options)
        assert {choice.side for choice in choices} == sides
    change = next(choice for choice in choices if choice.side)
    assert onto in change.chain.lanes
    assert abs(change.d_m) == pytest.approx(3.2, abs=0.05)  # a lane's width: the change has just begun


def test_arrival_times_are_interpolated_between_steps() -> None:
    """Constant 10 m/s, braking from 8 m/s at 8 m/s², and standing, each from 100 m on for 1 s."""
    now, speed = np.full(3, 100.0), np.array([[10.0] * 4, [6.0, 4.0, 2.0, 0.0], [0.0] * 4])
    s = 100.0 + np.array([[2.5, 5.0, 7.5, 10.0], [1.75, 3.0, 3.75, 4.0], [0.0] * 4])
    goals = np.array([[99.0, 100.0, 101.0, 102.5, 104.9, 110.0, 112.0]])
    never = np.inf
    expected = [
        [0.0, 0.0, 0.1, 0.25, 0.49, 1.0, 1.2],
        [0.0, 0.0, 0.25 / 1.75, 0.25 + 0.25 * 0.75 / 1.25, never, never, never],
        [0.0, 0.0, never, never, never, never, never],
    ]
    np.testing.assert_allclose(_time_at(now, s, speed, goals), expected)
    np.testing.assert_allclose(
        _time_at(now[:2], s[:2], speed[:2], np.array([[104.9], [101.0]])), [[0.49], [1 / 7]]
    )


@pytest.mark.parametrize(("braking_mps2", "after_mps"), [(2.0, 11.94), (4.0, 7.80), (6.0, 3.75)])
def test_hard_braking_is_predicted_to_last_longer(
    crossing: Maker, braking_mps2: float, after_mps: float
) -> None:
    """Two seconds from 13.89 m/s on, in eight steps.

    Braking of up to 3 m/s² fades with a time constant of 1 s (0.977 s of it are left), of 4 with 3 s (1.521), of 6 with
    5 s (1.690).
    """
    road = crossing()
    scene = make_scene(
        road, [Car("west_in_0", 20.0, 10.0), Car("west_in_0", 60.0, 13.89)], ("west_in", "east_out")
    )
    scene.history.speed_mps[1, :-1] += 0.5 * braking_mps2
    others = others_near(scene)
    ways = [way for way in ways_of(Geometry.of(road), scene, others) if way.weight > 0.0]
    ego = Ego(scene.history.xy_m[0, -1], 10.0, CAR_M[0], ())
    future = forecast(road, scene, others, ways, ego, 8)
    np.testing.assert_allclose(future.speed_mps[:, -1], after_mps, atol=0.01)
