"""Vehicles that are inserted for an encounter, on a straight lane of the motorway and at junctions of the downtown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.priority_traffic import priority_approaches
from advdiff_sumo.traffic.manoeuvres.repertoire import hard_stop, positioning_profile
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S
from advdiff_sumo.traffic.manoeuvres.staging import (
    HIDDEN_LASTS_S,
    SIZE_M,
    Newcomer,
    StagingMemory,
    _is_free,
    insert_newcomers,
    plan_with,
)
from tests.traffic.manoeuvres.scenes import scene_on, view_of


def test_a_leader_is_inserted_if_there_is_none(motorway: RoadMap) -> None:
    """At 10 m/s it is 1.5 s and 8 m ahead: 23 m."""
    view = view_of(motorway, target=(0, 50.0, 10.0))
    (leader,), stage = insert_newcomers(
        view, StagingMemory(most=3, classes=(AgentClass.TRUCK,)), ("hard-stop",)
    )
    assert leader.agent_class is AgentClass.TRUCK
    assert leader.speed_mps == 10.0
    assert view.target is not None
    ahead, left = view.target.way.line.project(leader.xy_m)
    assert float(ahead) - view.target.way.lane.s_m == pytest.approx(23.0, abs=0.1)
    assert abs(float(left)) < 0.1
    assert stage.count == 1


@pytest.mark.parametrize(
    ("cars", "stage"),
    [
        ({"leader": (0, 90.0, 10.0)}, StagingMemory(most=3)),
        ({"beside": (1, 80.0, 10.0)}, StagingMemory(most=0)),
        ({}, StagingMemory(most=3, count=3)),
        ({}, StagingMemory(most=3, next_try_s=1.0)),
    ],
)
def test_no_vehicle_is_inserted(
    motorway: RoadMap, cars: dict[str, tuple[int, float, float]], stage: StagingMemory
) -> None:
    """There is a leader; none may be inserted; all have been; it is too early for the next one."""
    view = view_of(motorway, target=(0, 50.0, 10.0), **cars)
    assert insert_newcomers(view, stage, ("hard-stop",))[0] == ()


def test_a_vehicle_inserted_beside_leaves_the_safe_gap(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0))
    (other,), _ = insert_newcomers(view, StagingMemory(most=3), ("cut-in",))
    assert view.target is not None
    ahead, left = view.target.way.line.project(other.xy_m)
    assert 2.5 < abs(float(left)) < 4.5
    assert float(ahead) - view.target.way.lane.s_m > 1.1 * 20.0 + SIZE_M[AgentClass.CAR][0]


def test_a_vehicle_inserted_ahead_of_a_fast_target_counts_as_its_leader(motorway: RoadMap) -> None:
    """At 33 m/s it is inserted 1.5 · 33 + 8 = 57.5 m ahead, and may stop hard there. A vehicle 70 m ahead may not."""
    view = view_of(motorway, target=(0, 50.0, 33.0))
    (leader,), _ = insert_newcomers(view, StagingMemory(most=3), ("hard-stop",))
    assert view.target is not None
    ahead = float(view.target.way.line.project(leader.xy_m)[0]) - view.target.way.lane.s_m
    assert ahead == pytest.approx(57.5, abs=0.1)
    for place, leads in ((50.0 + ahead, True), (120.0, False)):
        led = view_of(motorway, target=(0, 50.0, 33.0), leader=(0, place, 33.0))
        assert any(not m.is_positioning for m in hard_stop(led, 1)) == leads


def test_only_the_next_vehicle_ahead_gets_into_position_for_a_stop(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 75.0, 20.0), second=(0, 95.0, 20.0))
    assert [any(m.is_positioning for m in hard_stop(view, row)) for row in (1, 2)] == [True, False]


@pytest.mark.parametrize(("place_m", "is_inserted"), [(52.0, True), (95.0, False)])
def test_a_vehicle_is_inserted_beside_though_another_one_drives_there(
    place_m: float, is_inserted: bool, motorway: RoadMap
) -> None:
    """A vehicle level with a target at 20 m/s cannot get ahead of it; one 45 m ahead can change lanes itself."""
    view = view_of(motorway, target=(0, 50.0, 20.0), beside=(1, place_m, 20.0))
    assert bool(insert_newcomers(view, StagingMemory(most=3), ("cut-in",))[0]) == is_inserted


def test_the_wanted_speed_does_not_depend_on_the_present_speed(motorway: RoadMap) -> None:
    """26 m ahead of a target at 20 m/s it aims at the same speed, reached in 0.8 s, from 19 and from 21 m/s."""
    wishes = []
    for speed in (19.0, 20.0, 21.0):
        view = view_of(motorway, target=(0, 50.0, 20.0), other=(1, 76.0, speed))
        assert view.target is not None
        wishes.append(speed + 0.8 * positioning_profile(view, view.target, 1).first_mps2)
    assert wishes == pytest.approx([wishes[0]] * 3)


@pytest.mark.parametrize(("apart_m", "free"), [(9.6, False), (16.0, False), (16.5, True)])
def test_there_is_no_room_close_ahead_of_a_vehicle_on_the_junction(
    apart_m: float, free: bool, downtown: RoadMap
) -> None:
    """2 m beyond a straight junction at 12 m/s it needs 9 m and 0.6 s behind it, 16.2 m, also on the junction."""
    lane, inside = downtown.lanes["B2-C2_0"], downtown.lanes[":B2_3_0"]
    cars = {"target": (lane, 50.0, 12.0), "behind": (inside, inside.length_m + 2.0 - apart_m, 12.0)}
    view = SituationView.of(downtown, scene_on(cars))
    way = view.way_from(lane.line.at(2.0), (lane.edge_id,))
    assert way is not None
    newcomer = Newcomer(way, 12.0)
    assert np.linalg.norm(newcomer.xy_m - view.scene.history.xy_m[1, -1]) == pytest.approx(apart_m, abs=0.01)
    assert _is_free(view, newcomer, ()) == free


def test_a_plan_names_inserted_vehicles_and_their_routes(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 10.0))
    newcomers, _ = insert_newcomers(view, StagingMemory(most=3, count=1), ("hard-stop",))
    plan = plan_with(Tracks.empty(steps=1, dt_s=0.5, t0_s=0.5), newcomers)
    assert plan.tracks.ids == ("staged-1",)
    assert plan.routes["staged-1"][0] == view.scene.routes[0][0]
    driven = np.linalg.norm(np.diff(plan.tracks.xy_m[0], axis=0), axis=-1)
    assert driven == pytest.approx(np.full(11, 5.0), abs=0.05)


def minor_links(road: RoadMap) -> Iterator[Link]:
    for lane in road.lanes.values():
        for link in lane.successors:
            if not lane.is_internal and link.tls_id is None and link.state == "m" and lane.length_m > 60.0:
                yield link


def test_a_vehicle_with_priority_is_inserted_at_a_minor_approach(downtown: RoadMap) -> None:
    """It comes over a link to which the target must yield, and meets a target that does not respond."""
    links = list(minor_links(downtown))
    assert links
    for link in links:
        lane = downtown.lanes[link.from_lane]
        to = downtown.lanes[link.to_lane].edge_id
        scene = scene_on({"target": (lane, lane.length_m - 40.0, 8.0)})
        view = SituationView.of(downtown, replace(scene, routes=((lane.edge_id, to),)))
        newcomers, _ = insert_newcomers(view, StagingMemory(most=3), ("crossing",))
        for newcomer in newcomers:
            own_links = [x for _, x in newcomer.way.links if x.junction_id == link.junction_id]
            response = downtown.junctions[link.junction_id].response[link.request_index]
            assert own_links[0].request_index in response
            assert newcomer.route[0] != lane.edge_id
            assert view.target is not None
            driven = np.interp(CHECK_TIMES_S, FINE_TIMES_S, view.target.free_distance_m)
            target_xy = view.target.way.poses(driven, CHECK_TIMES_S)[0]
            own_xy = newcomer.way.poses(newcomer.speed_mps * CHECK_TIMES_S, CHECK_TIMES_S)[0]
            assert np.linalg.norm(target_xy - own_xy, axis=-1).min() < 6.0
        if newcomers:
            return
    pytest.fail("no vehicle is inserted at any minor approach of the downtown")


def test_no_vehicle_from_the_side_meets_a_target_that_cannot_stop_at_its_line(downtown: RoadMap) -> None:
    """At 8 m/s it needs 16 m: 6 m in 0.75 s, 8 m at 4 m/s² and half a car. A turning target may wait further on."""
    met = Counter[tuple[float, bool]]()
    for link in minor_links(downtown):
        lane = downtown.lanes[link.from_lane]
        for to_line_m in (20.0, 14.0):
            scene = scene_on({"target": (lane, lane.length_m - to_line_m, 8.0)})
            route = (lane.edge_id, downtown.lanes[link.to_lane].edge_id)
            view = SituationView.of(downtown, replace(scene, routes=(route,)))
            for approach in priority_approaches(view, oncoming=False):
                own_link = next(x for _, x in approach.way.links if x.junction_id == link.junction_id)
                own_lane = downtown.lanes[own_link.from_lane]
                turned = own_lane.line.segment_yaw_rad[-1] - lane.line.segment_yaw_rad[-1]
                met[to_line_m, bool(np.cos(turned) < -0.7)] += 1
    assert met[20.0, False]
    assert not met[14.0, False]


def test_a_standing_vehicle_is_inserted_ahead_of_a_leader(motorway: RoadMap) -> None:
    """At 9 m/s the leader is 18.5 m ahead, and the standing car 5 s and a lorry's length ahead of that."""
    view = view_of(motorway, target=(0, 50.0, 9.0))
    (leader, standing), stage = insert_newcomers(view, StagingMemory(most=3), ("cut-out",))
    assert view.target is not None
    along = view.target.way.line.project(np.array([leader.xy_m, standing.xy_m]))[0] - view.target.way.lane.s_m
    assert along == pytest.approx([18.5, 18.5 + 45.0 + 9.0], abs=0.1)
    assert (leader.speed_mps, standing.speed_mps) == (9.0, 0.0)
    assert stage.count == 2


def test_a_slow_vehicle_is_inserted_ahead_of_the_leader_of_a_fast_target(motorway: RoadMap) -> None:
    """At 25 m/s the leader is 42.1 m ahead. The other, at 8 m/s, is 5 s at the closing speed of 17 m/s beyond it."""
    view = view_of(motorway, target=(0, 50.0, 25.0))
    (leader, slow), _ = insert_newcomers(view, StagingMemory(most=3), ("cut-out",))
    assert view.target is not None
    way = view.extended_way(view.target.way, 150.0)
    along = way.line.project(np.array([leader.xy_m, slow.xy_m]))[0] - view.target.way.lane.s_m
    assert along == pytest.approx([42.1, 42.1 + 85.0 + 9.0], abs=0.1)
    assert (leader.speed_mps, slow.speed_mps) == (25.0, 8.0)
    assert (leader.is_hidden, slow.is_hidden) == (False, True)
    on_edges = sum(lane.length_m for lane in slow.way.lane.lanes) - slow.way.lane.s_m
    assert on_edges > HIDDEN_LASTS_S * 8.0


@pytest.mark.parametrize(
    ("cars", "stage"),
    [
        ({"leader": (0, 90.0, 9.0)}, StagingMemory(most=3)),
        ({"beside": (1, 90.0, 9.0)}, StagingMemory(most=3)),
        ({}, StagingMemory(most=1)),
    ],
)
def test_no_hidden_vehicle_is_inserted(
    cars: dict[str, tuple[int, float, float]], stage: StagingMemory, motorway: RoadMap
) -> None:
    """There is a leader; the next lane is taken; two vehicles are needed."""
    view = view_of(motorway, target=(0, 50.0, 9.0), **cars)
    assert insert_newcomers(view, stage, ("cut-out",))[0] == ()


def test_no_slow_vehicle_is_hidden_where_it_would_come_to_a_light(downtown: RoadMap) -> None:
    """A standing one is: it need not heed the light. At 20 m/s the vehicle would be slow, at 3 m/s for 20 s."""
    staged = Counter[float]()
    for lane in downtown.lanes.values():
        if lane.is_internal or lane.left_id is None or not any(link.tls_id for link in lane.successors):
            continue
        for speed_mps in (16.0, 20.0):
            view = SituationView.of(downtown, scene_on({"target": (lane, 5.0, speed_mps)}))
            staged[speed_mps] += len(insert_newcomers(view, StagingMemory(most=3), ("cut-out",))[0])
    assert staged[16.0]
    assert not staged[20.0]


def test_shares_of_the_classes_of_inserted_vehicles() -> None:
    """Of the first five two are lorries and two motorcycles. Of 600 four in ten are of each."""
    stages = [Commitments.start("any", np.random.default_rng(k), staged=6).stage for k in range(100)]
    count = Counter(agent_class for stage in stages for agent_class in stage.classes)
    assert count.total() == 600
    assert count[AgentClass.TRUCK] == pytest.approx(240, abs=40)
    assert count[AgentClass.MOTORCYCLE] == pytest.approx(240, abs=40)
    for stage in stages:
        five = Counter(stage.classes[:5])
        assert (five[AgentClass.TRUCK], five[AgentClass.MOTORCYCLE], five[AgentClass.CAR]) == (2, 2, 1)
    assert count.keys() == SIZE_M.keys()
