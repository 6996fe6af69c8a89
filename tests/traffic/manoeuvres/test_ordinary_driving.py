"""Before an attack the target has driven for some seconds with the attacker in view, and is led at a steady gap."""

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
    ("time_s", "since_s", "due"), [(2.5, 0.0, False), (3.0, 0.0, True), (4.5, 2.0, False), (5.0, 2.0, True)]
)
def test_a_stop_is_due_after_three_seconds_in_view(
    motorway: RoadMap, time_s: float, since_s: float, due: bool
) -> None:
    view = view_of(motorway, time_s=time_s, target=(0, 50.0, 10.0), leader=(0, 75.0, 10.0))
    stop = Manoeuvre("hard-stop", 1, view.ways[1])
    assert is_seen_long_enough(view, stop, {"leader": since_s}) is due
    assert is_seen_long_enough(view, replace(stop, sets_up=True), {"leader": since_s})


def test_a_change_of_lanes_may_begin_so_much_earlier_as_it_takes_to_the_line(motorway: RoadMap) -> None:
    """A third of a lane of 3.2 to 3.75 m at 1.1 m/s: over a second."""
    for time_s, due in ((1.5, False), (2.0, True)):
        view = view_of(motorway, time_s=time_s, target=(0, 50.0, 20.0), other=(1, 90.0, 20.0))
        change = next(m for m in KINDS["cut-in"](view, 1) if m.goal is not None)
        assert 1.0 <= change.enters_s(view.scene.history.xy_m[1, -1]) < 1.5
        assert is_seen_long_enough(view, change, {"other": 0.0}) is due


def test_somebody_is_in_view_since_it_came(motorway: RoadMap) -> None:
    view = view_of(motorway, time_s=4.0, target=(0, 50.0, 10.0), leader=(0, 75.0, 10.0))
    assert in_view_since(view, {"target": 0.0, "gone": 1.0}) == {"target": 0.0, "leader": 4.0}


@pytest.mark.parametrize(
    ("gap_m", "leads_mps", "accel_mps2"),
    [(17.0, 10.0, 0.0), (27.0, 10.0, -1.0), (17.0, 9.2, 1.0), (9.5, 10.0, 2.0)],
)
def test_a_leader_gets_to_a_second_and_a_half_ahead(
    motorway: RoadMap, gap_m: float, leads_mps: float, accel_mps2: float
) -> None:
    """A target at 10 m/s is led 17 m ahead: 10 m farther the leader aims at 7.5 m/s, 7.5 m nearer at 13 m/s.

    It gets there within 0.8 s, or as fast as −1 and 2 m/s² take it.
    """
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 50.0 + LENGTH_M + gap_m, leads_mps))
    assert view.target is not None
    assert steady_lead_profile(view, view.target, 1).first_mps2 == pytest.approx(accel_mps2, abs=0.01)


def test_who_gets_into_position_may_come_near_a_red_light_that_it_can_stop_at(downtown: RoadMap) -> None:
    """At 10 m/s it is 10 m on after a second, and stops 16.7 m later with 3 m/s²; a car's front is 2.25 m ahead."""
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
        goes_on = Manoeuvre("hard-stop", 1, view.ways[1], sets_up=True)
        futures = futures_of_manoeuvres([goes_on], np.array([10.0]))
        assert bool(lawful_mask(view, [goes_on], futures)[0]) is allowed
        assert has_red_ahead(view) is (lane.length_m - 5.0 < 80.0)
