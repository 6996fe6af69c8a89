"""Who sees the target's box on its way stops short of it, where SUMO, which looks along lanes, would not."""

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
from advdiff_sumo.traffic.manoeuvres.schedule import advance
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
    """Return how hard who has seen the target for a second brakes."""
    return [-m.profile.then_mps2 for m in waiting_manoeuvres(view, blocked_since(view, {"other": -1.0}))]


def test_who_would_run_into_a_box_that_reaches_over_stops_a_metre_short(motorway: RoadMap) -> None:
    """Lanes of 3.5 m, boxes of 1.8 m: 1.5 m aside, the boxes are 0.2 m apart across, less than the room of 0.25 m.

    The rear of the target is at 97.75 m, the other's front at 72.25 m: from 12 m/s it stops in 24.5 m with 2.94 m/s².
    """
    assert long_lane(motorway).width_m == pytest.approx(3.5)
    assert braked(beside(motorway, 1.5, (70.0, 12.0))) == [pytest.approx(144.0 / 2.0 / 24.5, rel=2e-3)]


def test_across_the_lane_it_is_seen_too(motorway: RoadMap) -> None:
    """Turned by 80°, its box spans 4.7 m across and 2.6 m along: the nearest point is 1.28 m before its centre."""
    assert braked(beside(motorway, 1.5, (70.0, 12.0), np.radians(80.0)))[0] > 2.5


@pytest.mark.parametrize("other", [(40.0, 8.0), (115.0, 8.0)])
def test_far_from_it_and_past_it_sumo_drives(motorway: RoadMap, other: tuple[float, float]) -> None:
    """From 55 m away 8 m/s need 0.6 m/s²; who is past it is not met."""
    assert braked(beside(motorway, 1.5, other)) == []


def test_a_free_way_is_left_to_sumo(motorway: RoadMap) -> None:
    view = beside(motorway, 0.0, (70.0, 12.0))
    assert blocked_since(view, {}) == {}
    assert waiting_manoeuvres(view, {}) == []


@pytest.mark.parametrize(
    ("at_m", "speed", "brakes"), [(70.0, 12.0, False), (70.0, 15.0, True), (92.5, 0.0, False)]
)
def test_a_leader_on_its_own_lane_is_left_to_sumo_where_that_stops(
    motorway: RoadMap, at_m: float, speed: float, brakes: bool
) -> None:
    """Half a second later 18.5 m are left at 12 m/s, so 3.9 m/s²; 17 m at 15 m/s, so 6.6 m/s², more than SUMO's 4.5.

    Who stands 3 m behind it is in SUMO's queue.
    """
    lane = long_lane(motorway)
    view = SituationView.of(motorway, scene_on({"target": (lane, 100.0, 0.0), "other": (lane, at_m, speed)}))
    assert bool(braked(view)) is brakes


def test_it_reacts_stands_and_goes_on(motorway: RoadMap) -> None:
    """It is seen at 0 s and answered after 0.75 s; who stands stays, until the target has left."""
    view = beside(motorway, 1.5, (70.0, 12.0))
    assert blocked_since(view, {}) == {"other": 0.0}
    assert waiting_manoeuvres(view, {"other": -0.5}) == []
    assert len(waiting_manoeuvres(view, {"other": -0.75})) == 1
    stands = beside(motorway, 1.5, (94.25, 0.0))
    assert len(waiting_manoeuvres(stands, blocked_since(stands, {"other": -3.0}))) == 1
    assert braked(beside(motorway, 0.0, (94.25, 0.0))) == []


def test_who_has_waited_for_long_passes_with_little_room(motorway: RoadMap) -> None:
    """The boxes are 0.15 m apart where the lanes' middles are 1.95 m."""
    lane = long_lane(motorway)
    aside = lane.width_m - 1.95
    view = beside(motorway, aside, (92.0, 0.0))
    assert blocked_since(view, {"other": -7.0}) == {"other": -7.0}
    assert blocked_since(view, {"other": -9.0}) == {}


def test_reckless_traffic_waits_for_nobody(motorway: RoadMap) -> None:
    view = beside(motorway, 1.5, (70.0, 12.0))
    kept = replace(Commitments.start("hard-stop", np.random.default_rng(0)), blocked_s={"other": -1.0})

    def waits(driven: list[Manoeuvre]) -> list[int]:
        return [m.row for m in driven if m.kind == WAITS]

    assert waits(advance(view, kept, 2, 8.0, LAWFUL)[0]) == [1]
    assert waits(advance(view, kept, 2, 8.0, None)[0]) == []


@pytest.mark.parametrize(("at_m", "stays"), [(94.25, True), (92.0, False)])
def test_who_stands_behind_a_box_that_creeps_stays_until_there_is_room(
    motorway: RoadMap, at_m: float, stays: bool
) -> None:
    """SUMO's driver would be at 1.3 m/s after half a second, the target, at 0.4 m/s, 0.2 m further on.

    Of a gap of 1.25 m 0.125 m are left then beyond the metre that is kept: 3.2 m/s²; of 3.5 m 2.4 m: 0.2 m/s².
    """
    assert bool(braked(beside(motorway, 1.5, (at_m, 0.0), speed_mps=0.4))) is stays


@pytest.mark.parametrize(("before_mps", "brakes"), [(8.0, False), (7.0, True)])
def test_who_gains_speed_towards_a_leader_does_not_follow_it(
    motorway: RoadMap, before_mps: float, brakes: bool
) -> None:
    """13.5 m before it, 8 m/s need 2.6 m/s²: SUMO's drivers gain no speed any more, unless they look past it."""
    lane = long_lane(motorway)
    view = SituationView.of(motorway, scene_on({"target": (lane, 100.0, 0.0), "other": (lane, 82.0, 8.0)}))
    view.scene.history.speed_mps[1, -2] = before_mps
    assert bool(braked(view)) is brakes


@pytest.mark.parametrize(("to_line_m", "brakes"), [(1.0, False), (-0.5, True)])
def test_a_box_beyond_a_line_is_seen_before_it_and_braked_for_behind_it(
    downtown: RoadMap, to_line_m: float, brakes: bool
) -> None:
    """Who has to give way is SUMO's up to the line; behind it nobody needs time to see what was there all along."""
    link = next(
        link
        for lane in downtown.lanes.values()
        for link in lane.successors
        if link.state == "m" and link.direction == "s" and link.tls_id is None and lane.length_m > 50.0
    )
    own, on = downtown.lanes[link.from_lane], downtown.lanes[link.via[0]]
    cars = {"target": (on, 8.0, 0.0), "other": (own, own.length_m - 2.25 - to_line_m, 6.0)}
    scene = replace(scene_on(cars), routes=((), (own.edge_id, downtown.lanes[link.to_lane].edge_id)))
    view = SituationView.of(downtown, _moved(scene, on.line.at(8.0)[0], np.radians(30.0)))
    assert blocked_since(view, {"other": -1.0}) == {"other": -1.0}
    assert bool(braked(view)) is brakes


def test_who_stands_closer_behind_a_leader_than_sumo_does_stays_too(motorway: RoadMap) -> None:
    """A metre behind a target that creeps on its own lane; behind one 3 m ahead SUMO drives."""
    lane = long_lane(motorway)
    for gap_m, stays in ((1.0, True), (3.0, False)):
        cars = {"target": (lane, 100.0, 0.4), "other": (lane, 95.5 - gap_m, 0.0)}
        assert bool(braked(SituationView.of(motorway, scene_on(cars)))) is stays
