"""The braking that a stop requires to its end, worked by hand, also if futures of 6 s end before it."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.demanded_braking import demanded_braking
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.required_braking import INSUFFICIENT_MPS2
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from tests.traffic.manoeuvres.scenes import LENGTH_M, long_lane, view_of


def demand(road: RoadMap, braking_mps2: float, gap_m: float = 30.0, lowest_mps: float = 0.0) -> float:
    """Return the braking that the leader of a target at the limit requires, *gap_m* ahead and as fast as the target."""
    speed = long_lane(road).speed_mps
    view = view_of(road, target=(0, 50.0, speed), leader=(0, 50.0 + LENGTH_M + gap_m, speed))
    stop = Manoeuvre(
        "hard-stop", 1, view.ways[1], SpeedProfile(then_mps2=-braking_mps2, lowest_mps=lowest_mps)
    )
    assert view.target is not None
    return float(
        demanded_braking(view, view.target, [stop], futures_of_manoeuvres([stop], np.array([speed])))[0]
    )


@pytest.mark.parametrize("braking_mps2", [2.0, 4.0, 6.0, 7.0, 8.5])
def test_a_stop_requires_braking_that_ends_behind_it(braking_mps2: float, motorway: RoadMap) -> None:
    """The leader stops v² / 2b further on. The target has that and 30 m, less 0.3 m and 0.75 s of driving."""
    v = long_lane(motorway).speed_mps
    least = 0.5 * v**2 / (30.0 - 0.3 + 0.5 * v**2 / braking_mps2 - 0.75 * v)
    expected = float(np.ceil(least)) if least <= 7.0 else INSUFFICIENT_MPS2
    assert demand(motorway, braking_mps2) == expected


def test_a_long_gentle_stop_requires_more_than_its_first_six_seconds(motorway: RoadMap) -> None:
    """At 2 m/s² the leader stands after more than 15 s. For the first 6 s, or if it crawls on, 1 m/s² is enough."""
    assert long_lane(motorway).speed_mps > 30.0
    assert demand(motorway, 2.0, lowest_mps=1.0) == 1.0
    assert demand(motorway, 2.0) == 2.0


def test_no_braking_suffices_without_room(motorway: RoadMap) -> None:
    assert demand(motorway, 8.5, gap_m=10.0) == INSUFFICIENT_MPS2


def test_a_vehicle_that_cuts_in_from_behind_has_a_negative_gap(motorway: RoadMap) -> None:
    """It is 9 m behind and faster, and has passed the target when it stops. The room counts from its present place."""
    v, faster, brakes, switch_s = 20.0, 10.0, 6.0, 4.0
    view = view_of(motorway, target=(0, 100.0, v), other=(1, 91.0, v + faster))
    goal = view.neighbour_way(1, "right")
    assert goal is not None
    assert view.target is not None
    profile = SpeedProfile(0.0, switch_s, -brakes)
    cut_in = Manoeuvre("cut-in", 1, view.ways[1], profile, goal)
    futures = futures_of_manoeuvres([cut_in], np.array([v + faster]))
    stop_distance_m = (v + faster) * switch_s + 0.5 * (v + faster) ** 2 / brakes
    perceived_s = cut_in.perceivable_s(view.scene.history.xy_m[1, -1])
    driven_m = float(np.interp(perceived_s + 0.75, FINE_TIMES_S, view.target.free_distance_m))
    speed = float(np.interp(perceived_s + 0.75, FINE_TIMES_S, view.target.free_speed_mps))
    least = 0.5 * speed**2 / (-9.0 - LENGTH_M + stop_distance_m - 0.3 - driven_m)
    assert demanded_braking(view, view.target, [cut_in], futures)[0] == np.ceil(least)
