"""What a stop demands of the target to its end, worked by hand, where futures of 6 s end before it."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.answers import UNANSWERABLE_MPS2
from advdiff_sumo.traffic.manoeuvres.demanded_braking import demanded_braking
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from tests.traffic.manoeuvres.scenes import LENGTH_M, long_lane, view_of


def demand(road: RoadMap, braking_mps2: float, gap_m: float = 30.0, lowest_mps: float = 0.0) -> float:
    """Return what the leader of a target at the limit demands, *gap_m* ahead and as fast as the target."""
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
def test_a_stop_demands_what_ends_behind_it(braking_mps2: float, motorway: RoadMap) -> None:
    """The leader stops v² / 2b further on; the target has that, 30 m less 0.3 m, and loses 0.75 s of driving."""
    v = long_lane(motorway).speed_mps
    least = 0.5 * v**2 / (30.0 - 0.3 + 0.5 * v**2 / braking_mps2 - 0.75 * v)
    expected = float(np.ceil(least)) if least <= 7.0 else UNANSWERABLE_MPS2
    assert demand(motorway, braking_mps2) == expected


def test_a_gentle_stop_that_takes_long_demands_more_than_is_seen_of_it(motorway: RoadMap) -> None:
    """At 2 m/s² the leader stands after over 15 s; in the first six, as for one that crawls on, 1 m/s² is enough."""
    assert long_lane(motorway).speed_mps > 30.0
    assert demand(motorway, 2.0, lowest_mps=1.0) == 1.0
    assert demand(motorway, 2.0) == 2.0


def test_nothing_helps_without_room(motorway: RoadMap) -> None:
    assert demand(motorway, 8.5, gap_m=10.0) == UNANSWERABLE_MPS2
