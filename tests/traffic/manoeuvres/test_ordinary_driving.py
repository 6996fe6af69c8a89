"""Before an attack the target drives for some seconds with the attacker in view, and a leader keeps a steady gap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.agenda import has_red_ahead
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.ordinary_driving import in_view_since, is_seen_long_enough
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS, steady_lead_profile
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from tests.traffic.manoeuvres.scenes import LENGTH_M, scene_on, view_of


@pytest.mark.parametrize(
    ("time_s", "since_s", "may_begin"),
    [(2.5, 0.0, False), (3.0, 0.0, True), (4.5, 2.0, False), (5.0, 2.0, True)],
)
def test_a_stop_may_begin_after_three_seconds_in_view(
    motorway: RoadMap, time_s: float, since_s: float, may_begin: bool
) -> None:
    view = view_of(motorway, time_s=time_s, target=(0, 50.0, 10.0), leader=(0, 75.0, 10.0))
    stop = Manoeuvre("hard-stop", 1, view.ways[1])
    assert is_seen_long_enough(view, stop, {"leader": since_s}) is may_begin
    assert is_seen_long_enough(view, replace(stop, is_positioning=True), {"leader": since_s})


def test_a_lane_change_may_begin_earlier_by_its_time_to_the_line(motorway: RoadMap) -> None:
    """A third of a lane of 3.2 to 3.75 m takes more than a second at 1.1 m/s."""
    for time_s, may_begin in ((1.5, False), (2.0, True)):
        view = view_of(motorway, time_s=time_s, target=(0, 50.0, 20.0), other=(1, 90.0, 20.0))
        change = next(m for m in KINDS["cut-in"](view, 1) if m.goal is not None)
        assert 1.0 <= change.enters_s(view.scene.history.xy_m[1, -1]) < 1.5
        assert is_seen_long_enough(view, change, {"other": 0.0}) is may_begin


def test_since_when_a_vehicle_is_in_view(motorway: RoadMap) -> None:
    view = view_of(motorway, time_s=4.0, target=(0, 50.0, 10.0), leader=(0, 75.0, 10.0))
    assert in_view_since(view, {"target": 0.0, "gone": 1.0}) == {"target": 0.0, "leader": 4.0}


@pytest.mark.parametrize(
    ("gap_m", "leader_mps", "accel_mps2"),
    [(17.0, 10.0, 0.0), (27.0, 10.0, -1.0), (17.0, 9.2, 1.0), (9.5, 10.0, 2.0)],
)
def test_a_leader_gets_to_a_headway_of_one_and_a_half_seconds(
    motorway: RoadMap, gap_m: float, leader_mps: float, accel_mps2: float
) -> None:
    """Before a target at 10 m/s the gap is 17 m. 10 m farther the leader aims at 7.5 m/s, 7.5 m nearer at 13 m/s.

    It reaches that speed within 0.8 s, but with −1 to 2 m/s² only.
    """
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 50.0 + LENGTH_M + gap_m, leader_mps))
    assert view.target is not None
    assert steady_lead_profile(view, view.target, 1).first_mps2 == pytest.approx(accel_mps2, abs=0.01)


def test_a_vehicle_may_get_into_position_before_a_red_light_if_it_can_stop(downtown: RoadMap) -> None:
    """At 10 m/s it drives 10 m in a second, then stops in 16.7 m with 3 m/s². Its front is 2.25 m ahead."""
    link = next(
        link
        for lane in downtown.lanes.values()
        for link in lane.successors
        if link.tls_id and not lane.is_internal and lane.length_m > 60.0
    )
    lane = downtown.lanes[link.from_lane]
    for to_line_m, allowed in ((28.0, False), (30.0, True)):
        scene = scene_on({"target": (lane, 5.0, 10.0), "other": (lane, lane.length_m - to_line_m, 10.0)})
        view = SituationView.of(downtown, replace(scene, signals={link.tls_id or "": "r" * 60}))
        steady = Manoeuvre("hard-stop", 1, view.ways[1], is_positioning=True)
        futures = futures_of_manoeuvres([steady], np.array([10.0]))
        assert bool(lawful_mask(view, [steady], futures)[0]) is allowed
        assert has_red_ahead(view) is (lane.length_m - 5.0 < 80.0)
