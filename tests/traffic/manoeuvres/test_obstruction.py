"""Vehicles stop before the target's box on their way, where SUMO, which looks along lanes, does not stop them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.licence import LAWFUL
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.obstruction import WAITS, blocked_since, waiting_manoeuvres
from advdiff_sumo.traffic.manoeuvres.schedule import update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from tests.traffic.manoeuvres.scenes import long_lane, scene_on


def beside(
    road: RoadMap, left_m: float, other: tuple[float, float], turned_rad: float = 0.0, speed_mps: float = 0.0
) -> SituationView:
    """Return a target at 100 m of the right lane, *left_m* aside and turned, and *other* (s, speed) on the left one."""
    right = long_lane(road)
    left = road.lanes[right.left_id or ""]
    scene = scene_on({"target": (right, 100.0, speed_mps), "other": (left, *other)})
    return SituationView.of(road, _moved(scene, right.line.at(100.0, left_m)[0], turned_rad))


def _moved(scene: Scene, xy_m: object, turned_rad: float) -> Scene:
    xy, yaw = scene.history.xy_m.copy(), scene.history.yaw_rad.copy()
    xy[0], yaw[0] = xy_m, yaw[0] + turned_rad
    return replace(scene, history=replace(scene.history, xy_m=xy, yaw_rad=yaw))


def braked(view: SituationView) -> list[float]:
    """Return the braking of a vehicle that has seen the target for a second."""
    return [-m.profile.then_mps2 for m in waiting_manoeuvres(view, blocked_since(view, {"other": -1.0}))]


def test_a_vehicle_stops_a_metre_before_a_box_that_reaches_into_its_lane(motorway: RoadMap) -> None:
    """With lanes of 3.5 m, boxes of 1.8 m and 1.5 m aside, the lateral distance is 0.2 m, less than 0.25 m.

    The target's rear is at 97.75 m, the other's front at 72.25 m. From 12 m/s it stops in 24.5 m with 2.94 m/s².
    """
    assert long_lane(motorway).width_m == pytest.approx(3.5)
    assert braked(beside(motorway, 1.5, (70.0, 12.0))) == [pytest.approx(144.0 / 2.0 / 24.5, rel=2e-3)]


def test_a_vehicle_brakes_for_a_target_across_its_lane(motorway: RoadMap) -> None:
    """Turned by 80°, its box spans 4.7 m across and 2.6 m along. The nearest point is 1.28 m before its centre."""
    assert braked(beside(motorway, 1.5, (70.0, 12.0), np.radians(80.0)))[0] > 2.5


@pytest.mark.parametrize("other", [(40.0, 8.0), (115.0, 8.0)])
def test_sumo_drives_vehicles_that_are_far_or_past_the_target(
    motorway: RoadMap, other: tuple[float, float]
) -> None:
    """From 55 m away 8 m/s require 0.6 m/s². A vehicle that has passed the target needs none."""
    assert braked(beside(motorway, 1.5, other)) == []


def test_a_free_way_is_left_to_sumo(motorway: RoadMap) -> None:
    view = beside(motorway, 0.0, (70.0, 12.0))
    assert blocked_since(view, {}) == {}
    assert waiting_manoeuvres(view, {}) == []


@pytest.mark.parametrize(
    ("at_m", "speed", "brakes"), [(70.0, 12.0, False), (70.0, 15.0, True), (92.5, 0.0, False)]
)
def test_a_follower_on_the_targets_lane_is_left_to_sumo_if_that_stops_it(
    motorway: RoadMap, at_m: float, speed: float, brakes: bool
) -> None:
    """Half a second later 12 m/s have 18.5 m left, 3.9 m/s²; 15 m/s have 17 m, 6.6 m/s², more than SUMO's 4.5.

    A vehicle that stands 3 m behind the target is in SUMO's queue.
    """
    lane = long_lane(motorway)
    view = SituationView.of(motorway, scene_on({"target": (lane, 100.0, 0.0), "other": (lane, at_m, speed)}))
    assert bool(braked(view)) is brakes


def test_a_vehicle_reacts_waits_and_drives_on(motorway: RoadMap) -> None:
    """It sees the target at 0 s and reacts after 0.75 s. Once it stands it waits until the target has left."""
    view = beside(motorway, 1.5, (70.0, 12.0))
    assert blocked_since(view, {}) == {"other": 0.0}
    assert waiting_manoeuvres(view, {"other": -0.5}) == []
    assert len(waiting_manoeuvres(view, {"other": -0.75})) == 1
    stands = beside(motorway, 1.5, (94.25, 0.0))
    assert len(waiting_manoeuvres(stands, blocked_since(stands, {"other": -3.0}))) == 1
    assert braked(beside(motorway, 0.0, (94.25, 0.0))) == []


def test_after_a_long_wait_a_vehicle_passes_with_little_room(motorway: RoadMap) -> None:
    """With centres 1.95 m apart, the lateral distance of the boxes is 0.15 m."""
    lane = long_lane(motorway)
    aside = lane.width_m - 1.95
    view = beside(motorway, aside, (92.0, 0.0))
    assert blocked_since(view, {"other": -7.0}) == {"other": -7.0}
    assert blocked_since(view, {"other": -9.0}) == {}


def test_reckless_traffic_does_not_wait(motorway: RoadMap) -> None:
    view = beside(motorway, 1.5, (70.0, 12.0))
    kept = replace(Commitments.start("hard-stop", np.random.default_rng(0)), blocked_s={"other": -1.0})

    def waits(driven: list[Manoeuvre]) -> list[int]:
        return [m.row for m in driven if m.kind == WAITS]

    assert waits(update_manoeuvres(view, kept, 2, 8.0, LAWFUL)[0]) == [1]
    assert waits(update_manoeuvres(view, kept, 2, 8.0, None)[0]) == []


@pytest.mark.parametrize(("at_m", "waits"), [(94.25, True), (92.0, False)])
def test_a_vehicle_waits_behind_a_creeping_box_until_there_is_room(
    motorway: RoadMap, at_m: float, waits: bool
) -> None:
    """After half a second SUMO's driver would be at 1.3 m/s, and the target, at 0.4 m/s, 0.2 m further on.

    Beyond the metre that is kept, a gap of 1.25 m then leaves 0.125 m, 3.2 m/s²; one of 3.5 m leaves 2.4 m, 0.2 m/s².
    """
    assert bool(braked(beside(motorway, 1.5, (at_m, 0.0), speed_mps=0.4))) is waits


@pytest.mark.parametrize(("before_mps", "brakes"), [(8.0, False), (7.0, True)])
def test_a_vehicle_that_accelerates_towards_a_leader_does_not_follow_it(
    motorway: RoadMap, before_mps: float, brakes: bool
) -> None:
    """13.5 m before it, 8 m/s require 2.6 m/s². SUMO's drivers do not accelerate then, unless they overlook it."""
    lane = long_lane(motorway)
    view = SituationView.of(motorway, scene_on({"target": (lane, 100.0, 0.0), "other": (lane, 82.0, 8.0)}))
    view.scene.history.speed_mps[1, -2] = before_mps
    assert bool(braked(view)) is brakes


@pytest.mark.parametrize(("to_line_m", "brakes"), [(1.0, False), (-0.5, True)])
def test_a_vehicle_brakes_for_a_box_on_a_junction_only_beyond_its_line(
    downtown: RoadMap, to_line_m: float, brakes: bool
) -> None:
    """SUMO drives a vehicle that must yield up to its line. Beyond it the reaction time has passed already."""
    link = next(
        link
        for lane in downtown.lanes.values()
        for link in lane.successors
        if link.state == "m" and link.direction == "s" and link.tls_id is None and lane.length_m > 50.0
    )
    own, inner = downtown.lanes[link.from_lane], downtown.lanes[link.via[0]]
    cars = {"target": (inner, 8.0, 0.0), "other": (own, own.length_m - 2.25 - to_line_m, 6.0)}
    scene = replace(scene_on(cars), routes=((), (own.edge_id, downtown.lanes[link.to_lane].edge_id)))
    view = SituationView.of(downtown, _moved(scene, inner.line.at(8.0)[0], np.radians(30.0)))
    assert blocked_since(view, {"other": -1.0}) == {"other": -1.0}
    assert bool(braked(view)) is brakes


def test_a_vehicle_waits_if_it_is_closer_to_its_leader_than_sumo_allows(motorway: RoadMap) -> None:
    """It waits a metre behind a target that creeps on the same lane. With 3 m SUMO drives it."""
    lane = long_lane(motorway)
    for gap_m, waits in ((1.0, True), (3.0, False)):
        cars = {"target": (lane, 100.0, 0.4), "other": (lane, 95.5 - gap_m, 0.0)}
        assert bool(braked(SituationView.of(motorway, scene_on(cars)))) is waits
