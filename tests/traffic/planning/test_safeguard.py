"""The safeguard on the shipped net downtown: leaving the road, standing vehicles, red lights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.boxes import corners
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Lane
from advdiff_sumo.traffic.planning.futures import Futures, constant_velocity_futures
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead, lanes_ahead
from advdiff_sumo.traffic.planning.road_bound import leaves_road
from advdiff_sumo.traffic.planning.safeguard import (
    SafeguardedPlans,
    SafeguardInput,
    safeguard,
    stop_distances,
)

T, DT = 12, 0.5
BOTH, SECOND = np.ones(2, dtype=np.bool_), np.array([False, True])
SIZE = (4.6, 1.9)


@pytest.fixture(scope="module")
def lane(downtown: RoadMap) -> Lane:
    """Return a long straight lane that ends at a traffic light."""
    lanes = [
        x
        for x in downtown.lanes.values()
        if not x.is_internal and x.permits("passenger") and any(y.tls_id for y in x.successors)
    ]
    return max(lanes, key=lambda x: (x.length_m, x.id))


def on(lane: Lane, s: float, speed: float, left: float = 0.0, turn: float = 0.0) -> Futures:
    """Return a parked car 40 m aside as the target, and a car on *lane* that drives straight on."""
    xy, yaw = lane.line.at(np.array([s]), left)
    aside = np.array((-np.sin(yaw[0]), np.cos(yaw[0])))
    xy = np.vstack((xy[0] + (40.0 - left) * aside, xy))
    return constant_velocity_futures(
        xy, np.array([0.0, yaw[0] + turn]), np.array([0.0, speed]), np.tile(SIZE, (2, 1)), T, DT
    )


def ahead(road: RoadMap, futures: Futures) -> list[LaneAhead | None]:
    return [
        None,
        *lanes_ahead(road, futures.xy_m[1:, 0], futures.yaw_rad[1:, 0], [()] * (futures.agents - 1)),
    ]


def inputs_of(
    road: RoadMap, futures: Futures, attacks: bool = False, light: str = "G", far_follow_lanes: bool = False
) -> SafeguardInput:
    planned = np.arange(futures.agents) > 0
    lights = {x.tls_id: 60 * light for y in road.lanes.values() for x in y.successors if x.tls_id}
    stood = planned & (futures.speed_mps[:, 0] == 0.0)
    return SafeguardInput(
        is_planned=planned,
        is_attacker=planned & attacks,
        target=0,
        is_motor=np.ones_like(planned),
        is_unprotected=np.zeros_like(planned),
        has_stood=stood,
        has_crept=planned & (futures.speed_mps[:, 0] < 2.0),
        limit_share=np.where(planned & attacks, 1.5, 1.15),
        far_follow_lanes=far_follow_lanes,
        lanes=ahead(road, futures),
        signals=lights,
        yield_stop_m=np.full(futures.agents, np.inf),
    )


def guarded(road: RoadMap, futures: Futures, **how: object) -> SafeguardedPlans:
    return safeguard(road, futures, inputs_of(road, futures, **how))  # type: ignore[arg-type] # see above


def test_a_plan_along_the_lane_is_unchanged(downtown: RoadMap, lane: Lane) -> None:
    plans = on(lane, 10.0, 6.0)
    made = guarded(downtown, plans)
    assert not np.any((made.follows_lane, made.held, made.braked, made.unsolved))
    np.testing.assert_array_equal(made.futures.xy_m, plans.xy_m)


def test_a_plan_off_the_road_is_replaced_by_one_along_the_lane(downtown: RoadMap, lane: Lane) -> None:
    plans = on(lane, 10.0, 8.0, turn=0.5)
    assert leaves_road(downtown, plans, SECOND, BOTH).tolist() == [False, True]
    made = guarded(downtown, plans)
    assert made.follows_lane.tolist() == [False, True]
    assert not leaves_road(downtown, made.futures, BOTH, BOTH)[1]
    s, d = lane.line.project(made.futures.xy_m[1])
    assert abs(d[-1]) < 0.3 or s[-1] >= lane.length_m - 5.0
    assert (np.diff(s) > -0.01).all()


def test_a_plausible_plan_is_unchanged_at_any_distance_from_the_target(downtown: RoadMap, lane: Lane) -> None:
    """Half a metre beside the centre of its lane: it returns to the centre only when it is handed back to SUMO."""
    plans = on(lane, 10.0, 4.0, left=0.5)
    for _ in range(3):
        np.testing.assert_array_equal(guarded(downtown, plans).futures.xy_m[1], plans.xy_m[1])
        plans.xy_m[0] += plans.xy_m[0] - plans.xy_m[1, :1]


def test_among_reckless_attackers_vehicles_far_from_the_target_follow_their_lanes(
    downtown: RoadMap, lane: Lane
) -> None:
    """Half a metre beside the centre of its lane; 40 m from the target it stays there, 80 m from it it returns."""
    plans = on(lane, 10.0, 4.0, left=0.5)
    made = guarded(downtown, plans, far_follow_lanes=True)
    np.testing.assert_array_equal(made.futures.xy_m[1], plans.xy_m[1])
    plans.xy_m[0] += plans.xy_m[0] - plans.xy_m[1, :1]
    made = guarded(downtown, plans, far_follow_lanes=True)
    assert not made.follows_lane.any()  # only counts plans that would have left the road
    assert abs(lane.line.project(made.futures.xy_m[1, 6])[1]) < 0.3


def test_a_car_off_the_road_may_stay_there(downtown: RoadMap, lane: Lane) -> None:
    """The share of the box off the road now does not count, as for cars parked on the kerb."""
    plans = on(lane, 10.0, 0.0, left=-60.0)
    assert not leaves_road(downtown, plans, SECOND, BOTH).any()


def test_a_car_off_the_road_does_not_drive_on_beside_it(downtown: RoadMap, lane: Lane) -> None:
    """60 m beside the lane it has no lane and stops; 3.5 m beside it, it returns."""
    far, near = on(lane, 10.0, 6.0, left=-60.0), on(lane, 10.0, 6.0, left=-3.5)
    for plans in (far, near):
        assert downtown.off_road_share(boxes(plans))[:7].min() > 0.25
        assert leaves_road(downtown, plans, SECOND, BOTH).tolist() == [False, True]
        assert not leaves_road(downtown, plans, SECOND, ~BOTH).any()  # a bicycle on its own path
    assert guarded(downtown, far).futures.travelled_m()[1, -1] <= 0.5 * 6.0**2 / 6.0 + 0.01
    back = guarded(downtown, near).futures
    assert abs(lane.line.project(back.xy_m[1, -1])[1]) < 0.5


def boxes(plans: Futures) -> np.ndarray:
    return corners(plans.xy_m[1], plans.yaw_rad[1], np.tile(SIZE, (T + 1, 1)))


@pytest.mark.parametrize(("attacks", "share"), [(False, 1.15), (True, 1.5)])
def test_no_vehicle_exceeds_its_share_of_the_limit(
    downtown: RoadMap, lane: Lane, attacks: bool, share: float
) -> None:
    """At twice the limit within 6 s, towards a green light."""
    plans = on(lane, 5.0, lane.speed_mps)
    pace = lane.speed_mps * (1.0 + np.arange(T + 1) / T)
    driven = np.append(0.0, np.cumsum(0.5 * DT * (pace[1:] + pace[:-1])))
    plans.xy_m[1], plans.yaw_rad[1] = lane.line.at(5.0 + driven, extrapolate=True)
    plans.speed_mps[1] = pace
    inputs = replace(inputs_of(downtown, plans, attacks), is_planned=SECOND)
    made = safeguard(downtown, plans, inputs).futures
    on_lane = lane.line.project(made.xy_m[1])[0] < lane.length_m
    assert made.speed_mps[1, on_lane].max() == pytest.approx(share * lane.speed_mps, abs=0.1)


@pytest.mark.parametrize(
    ("attacks", "has_crept", "goes"), [(True, True, True), (True, False, False), (False, False, True)]
)
def test_a_vehicle_standing_on_a_junction_leaves_it(
    downtown: RoadMap, attacks: bool, has_crept: bool, goes: bool
) -> None:
    """It plans to stand in the middle of a bend for good; attackers may for two seconds."""
    inner = max((x for x in downtown.lanes.values() if x.is_internal), key=lambda x: (x.length_m, x.id))
    plans = on(inner, 0.5 * inner.length_m, 0.0)
    inputs = replace(inputs_of(downtown, plans, attacks), has_crept=SECOND & has_crept)
    made = safeguard(downtown, plans, inputs)
    assert made.held.tolist() == [False, not goes]
    assert (made.futures.travelled_m()[1, -1] > 5.0) == goes


@pytest.mark.parametrize(("attacks", "goes"), [(True, False), (False, True)])
def test_a_vehicle_creeping_on_a_junction_clears_it(downtown: RoadMap, attacks: bool, goes: bool) -> None:
    """At 0.8 m/s for two seconds and, as planned, six more; an attacker may."""
    inner = max((x for x in downtown.lanes.values() if x.is_internal), key=lambda x: (x.length_m, x.id))
    plans = on(inner, 0.5 * inner.length_m, 0.8)
    made = safeguard(downtown, plans, inputs_of(downtown, plans, attacks))
    assert (made.futures.travelled_m()[1, -1] > 10.0) == goes
    assert made.futures.travelled_m()[1, -1] > 4.7


@pytest.mark.parametrize(("attacks", "before_m"), [(False, 5.0), (False, 30.0), (True, 5.0)])
def test_only_attackers_stop_on_a_junction(
    downtown: RoadMap, lane: Lane, attacks: bool, before_m: float
) -> None:
    """From 8 m/s with 4 m/s² it stands after 8 m: 3 m over the line, or well before it."""
    plans = on(lane, lane.length_m - before_m, 8.0)
    speed = np.maximum(8.0 - 4.0 * DT * np.arange(T + 1), 0.0)
    driven = np.append(0.0, np.cumsum(0.5 * DT * (speed[1:] + speed[:-1])))
    plans.xy_m[1], plans.yaw_rad[1] = lane.line.at(lane.length_m - before_m + driven, extrapolate=True)
    plans.speed_mps[1] = speed
    made = safeguard(downtown, plans, inputs_of(downtown, plans, attacks))
    stops = attacks or before_m > 8.0
    assert (made.futures.travelled_m()[1, -1] == pytest.approx(8.0, abs=0.01)) == stops
    assert (made.futures.travelled_m()[1, -1] > 25.0) != stops


@pytest.mark.parametrize(("stood", "brakes"), [(True, False), (False, True)])
def test_a_target_that_has_stood_is_predicted_to_stand(
    downtown: RoadMap, lane: Lane, stood: bool, brakes: bool
) -> None:
    """It stands 4 m beside the lane; its prediction pulls out across it."""
    plans = on(lane, 10.0, 8.0)
    aside = plans.xy_m[0, 0] - plans.xy_m[1, 0]
    aside /= np.linalg.norm(aside)
    plans.xy_m[0] = plans.xy_m[1, 3] + np.linspace(4.0, 0.0, T + 1)[:, None] * aside
    plans.yaw_rad[0] = np.arctan2(-aside[1], -aside[0])
    inputs = replace(inputs_of(downtown, plans), has_stood=~SECOND & stood)
    made = safeguard(downtown, plans, inputs)
    assert made.braked.tolist() == [False, brakes]


@pytest.mark.parametrize(("speed", "held"), [(0.0, True), (0.15, True), (0.3, False)])
def test_a_standing_vehicle_with_hardly_any_plan_stands_still(
    downtown: RoadMap, lane: Lane, speed: float, held: bool
) -> None:
    """0.15 m/s is 0.225 m in 1.5 s."""
    plans = on(lane, 10.0, speed)
    made = guarded(downtown, plans)
    assert made.held.tolist() == [False, held]
    if held:
        np.testing.assert_array_equal(made.futures.xy_m[1], np.tile(plans.xy_m[1, 0], (T + 1, 1)))
        assert (made.futures.speed_mps[1, 1:] == 0.0).all()


def test_a_starting_vehicle_is_not_held(downtown: RoadMap, lane: Lane) -> None:
    """0.5 m/s² from standing is 0.56 m in 1.5 s."""
    plans = on(lane, 10.0, 0.0)
    time = DT * np.arange(T + 1)
    heading = np.array((np.cos(plans.yaw_rad[1, 0]), np.sin(plans.yaw_rad[1, 0])))
    plans.xy_m[1] += (0.25 * time**2)[:, None] * heading
    plans.speed_mps[1] = 0.5 * time
    assert not guarded(downtown, plans).held.any()


def test_a_vehicle_that_has_stood_and_plans_to_start_later_starts_now(downtown: RoadMap, lane: Lane) -> None:
    """A wait of 2 s, then 1 m/s²: the 0.125 m up to 2.5 s are driven in the first half second."""
    plans = on(lane, 10.0, 0.0)
    time = np.maximum(DT * np.arange(T + 1) - 2.0, 0.0)
    heading = np.array((np.cos(plans.yaw_rad[1, 0]), np.sin(plans.yaw_rad[1, 0])))
    plans.xy_m[1] += (0.5 * time**2)[:, None] * heading
    plans.speed_mps[1] = time
    plans.speed_mps[1, 0] = 0.0
    inputs = inputs_of(downtown, plans)
    made = safeguard(downtown, plans, inputs)
    assert not made.held.any()
    assert made.futures.travelled_m()[1, :4].tolist() == pytest.approx([0.0, 0.125, 0.5, 1.125])
    still = safeguard(downtown, plans, replace(inputs, has_stood=np.zeros(2, dtype=np.bool_)))
    assert still.held[1]


@pytest.mark.parametrize(
    ("light", "speed", "attacks", "stops"),
    [
        ("r", 8.0, False, True),  # needs 8² / (2 · 22) = 1.5 m/s²
        ("y", 8.0, False, True),
        ("G", 8.0, False, False),
        ("g", 8.0, False, False),
        ("r", 8.0, True, False),  # signals do not bind attackers
        ("y", 14.0, False, False),  # 14² / 44 = 4.5 m/s²: too hard for yellow …
        ("r", 14.0, False, True),  # … but not for red
        ("r", 18.0, False, False),  # 7.4 m/s²: too late
    ],
)
def test_red_lights(
    downtown: RoadMap, lane: Lane, light: str, speed: float, attacks: bool, stops: bool
) -> None:
    """25.3 m before the stop line, less half a length of 2.3 m and a margin of 1 m: 22 m."""
    plans = on(lane, lane.length_m - 25.3, speed)
    inputs = inputs_of(downtown, plans, attacks, light)
    room = stop_distances(plans, inputs, inputs.is_planned)[1]
    assert (room == pytest.approx(22.0, abs=0.05)) if stops else np.isinf(room)
    made = safeguard(downtown, plans, inputs)
    if stops:
        driven = made.futures.travelled_m()[1, -1]
        assert driven <= 22.05
        assert made.futures.speed_mps[1, -1] < 2.0


def test_a_vehicle_over_the_line_continues(downtown: RoadMap, lane: Lane) -> None:
    plans = on(lane, lane.length_m - 1.0, 3.0)
    inputs = inputs_of(downtown, plans, light="r")
    assert np.isinf(stop_distances(plans, inputs, inputs.is_planned)).all()


def test_the_order_of_vehicles_does_not_matter(downtown: RoadMap, lane: Lane) -> None:
    s, speed = np.array([20.0, 32.0, 44.0, 60.0]), np.array([12.0, 9.0, 6.0, 0.0])
    xy, yaw = lane.line.at(s)
    plans = constant_velocity_futures(xy, yaw, speed, np.tile(SIZE, (4, 1)), T, DT)
    far = on(lane, 0.0, 0.0)

    def run(order: list[int]) -> np.ndarray:
        rows = np.array(order)
        joined = replace(
            plans,
            xy_m=np.vstack((far.xy_m[:1], plans.xy_m[rows])),
            yaw_rad=np.vstack((far.yaw_rad[:1], plans.yaw_rad[rows])),
            speed_mps=np.vstack((far.speed_mps[:1], plans.speed_mps[rows])),
            size_m=np.tile(SIZE, (5, 1)),
        )
        return guarded(downtown, joined).futures.xy_m[1:]

    np.testing.assert_array_equal(run([0, 1, 2, 3]), run([3, 1, 0, 2])[[2, 1, 3, 0]])


def test_a_vehicle_that_cannot_brake_in_time_continues_its_previous_plan(
    downtown: RoadMap, lane: Lane
) -> None:
    """The new plan at 10 m/s, 0.6 m to the left, hits a car that stands 6 m ahead; the previous plan passes it."""
    moving, parked = on(lane, 10.0, 10.0), on(lane, 16.0, 0.0, left=2.2)
    plans = replace(
        moving,
        xy_m=np.concatenate((moving.xy_m, parked.xy_m[1:])),
        yaw_rad=np.concatenate((moving.yaw_rad, parked.yaw_rad[1:])),
        speed_mps=np.concatenate((moving.speed_mps, parked.speed_mps[1:])),
        size_m=np.tile(SIZE, (3, 1)),
    )
    s = 10.0 + 5.0 * np.arange(1, T + 1)
    before = *lane.line.at(s), np.full(T, 10.0)
    plans.xy_m[1, 1:], plans.yaw_rad[1, 1:] = lane.line.at(s, 0.6)
    inputs = replace(
        inputs_of(downtown, plans), is_planned=np.array([False, True, False]), lanes=[None, None, None]
    )
    assert safeguard(downtown, plans, inputs).unsolved.tolist() == [False, True, False]
    made = safeguard(downtown, plans, replace(inputs, previous={1: before}))
    assert not made.unsolved.any()
    np.testing.assert_allclose(made.futures.xy_m[1, 1:7], before[0][:6], atol=1e-9)
