"""Plans judged with the breach rules of the verdict, worked by hand on a straight lane."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches import BreachKind
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.plan_breaches import plan_breaches
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from tests.traffic.manoeuvres.scenes import LENGTH_M, view_of


def breaches(view: SituationView, manoeuvre: Manoeuvre) -> frozenset[BreachKind]:
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    return plan_breaches(view, [manoeuvre.row], futures.xy_m, futures.yaw_rad, futures.speed_mps)[0]


def test_a_leader_that_stops_hard_breaks_no_rule(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 80.0, 20.0))
    assert (
        breaches(view, Manoeuvre("hard-stop", 1, view.ways[1], SpeedProfile(then_mps2=-8.0))) == frozenset()
    )


def test_running_into_the_rear_of_the_target_is_a_breach(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 90.0, 15.0), follower=(0, 60.0, 28.0))
    assert BreachKind.RAN_INTO in breaches(view, Manoeuvre("hard-stop", 1, view.ways[1], SpeedProfile()))


def test_a_cut_in_without_room_is_a_breach(motorway: RoadMap) -> None:
    for gap, kinds in ((8.0, {BreachKind.UNSAFE_LANE_ENTRY}), (40.0, set())):
        view = view_of(motorway, target=(0, 50.0, 22.0), other=(1, 50.0 + LENGTH_M + gap, 20.0))
        goal = next(m.goal for m in KINDS["cut-in"](view, 1) if m.goal is not None)
        slows = Manoeuvre("cut-in", 1, view.ways[1], SpeedProfile(0.0, 1.5, -3.5, 8.0), goal)
        assert breaches(view, slows) == kinds


def test_driving_far_too_fast_is_a_breach_without_contact(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), other=(1, 110.0, 30.0))
    limit = view.ways[1].lane.speed_mps
    races = SpeedProfile(6.0, 6.0, highest_mps=1.5 * limit)
    assert breaches(view, Manoeuvre("cut-in", 1, view.ways[1], races)) == {BreachKind.SPEEDING}
