"""A vehicle that stays in the target's blind spot: where it drives, when it begins and ends, and what is recorded."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.blind_spot import blind_spot
from advdiff_sumo.traffic.manoeuvres.close_pass import SLOW_LEADER
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.repertoire import BLIND_SPOT
from advdiff_sumo.traffic.manoeuvres.schedule import update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory, insert_newcomers
from tests.traffic.manoeuvres.scenes import shifted, view_of

TARGET = {"target": (0, 100.0, 20.0)}
PLACE_M = -3.3
"""Cars of 4.5 m whose boxes overlap by 1.2 m."""


def beside(ahead_m: float, speed_mps: float) -> dict[str, tuple[int, float, float]]:
    """Return a vehicle on the lane to the left, *ahead_m* of the target."""
    return {"other": (1, 100.0 + ahead_m, speed_mps)}


@pytest.mark.parametrize(
    ("ahead_m", "speed_mps", "positioning", "wish_mps"),
    [
        (-30.0, 20.0, True, 25.0),  # at most 5 m/s faster
        (-9.3, 20.0, True, 23.0),  # 6 m behind its place, half of that per second
        (-4.3, 20.0, False, 20.5),
        (PLACE_M, 20.0, False, 20.0),
        (-2.3, 21.0, False, 19.5),
        (2.7, 20.0, True, 17.0),
    ],
)
def test_it_gets_to_its_place_and_keeps_it(
    motorway: RoadMap, ahead_m: float, speed_mps: float, positioning: bool, wish_mps: float
) -> None:
    """It accelerates with 2 m/s² at most and brakes with 4, for 0.8 s."""
    (driven,) = blind_spot(view_of(motorway, **TARGET, **beside(ahead_m, speed_mps)), 1)
    assert (driven.kind, driven.is_positioning) == (BLIND_SPOT, positioning)
    reached = speed_mps + 0.8 * driven.profile.first_mps2
    assert reached == pytest.approx(np.clip(wish_mps, speed_mps - 3.2, speed_mps + 1.6), abs=0.02)
    assert driven.way.keeps_left_m == 0.0  # the middle of its lane


def test_it_drives_no_faster_than_the_limit(motorway: RoadMap) -> None:
    limit = view_of(motorway, **TARGET, **beside(-6.0, 21.0)).ways[1].lane.speed_mps
    (driven,) = blind_spot(view_of(motorway, target=(0, 100.0, limit), **beside(-20.0, limit)), 1)
    assert driven.profile.first_mps2 == 0.0


def test_it_lets_a_target_in_that_changes_lanes_ahead_of_it(motorway: RoadMap) -> None:
    behind, level = (view_of(motorway, **TARGET, **beside(ahead_m, 20.0)) for ahead_m in (-6.0, PLACE_M))
    assert not list(blind_spot(shifted(behind, 0, 0.8, 0.8), 1))
    assert list(blind_spot(shifted(level, 0, 0.8, 0.8), 1))  # too late


@pytest.mark.parametrize("speeds_mps", [(4.9, 20.0), (20.0, 4.9)])
def test_it_ends_where_one_of_them_is_slow(motorway: RoadMap, speeds_mps: tuple[float, float]) -> None:
    cars = {"target": (0, 100.0, speeds_mps[0]), **beside(PLACE_M, speeds_mps[1])}
    assert not list(blind_spot(view_of(motorway, **cars), 1))


def test_it_and_the_slow_leader_are_recorded(motorway: RoadMap) -> None:
    memory = Commitments.start(BLIND_SPOT, np.random.default_rng(0))
    cars = {**TARGET, "leader": (0, 140.0, 20.0), **beside(PLACE_M, 20.0)}
    for time_s in (5.0, 8.0):  # it comes into view, and is seen long enough
        driven, memory = update_manoeuvres(view_of(motorway, time_s, **cars), memory, 2, 8.0)
    assert {m.kind for m in driven} == {BLIND_SPOT, SLOW_LEADER}
    assert memory.attacking == ("other",)
    assert memory.manoeuvres == {"other": BLIND_SPOT, "leader": SLOW_LEADER}


def test_it_and_a_leader_are_inserted(motorway: RoadMap) -> None:
    view = view_of(motorway, **TARGET)
    newcomers, _ = insert_newcomers(view, StagingMemory(most=6), (BLIND_SPOT,))
    places = [view.ways[0].line.project(newcomer.xy_m) for newcomer in newcomers]
    assert [(round(float(s) - 100.0), round(float(left) / 3.5)) for s, left in places] == [(-19, 1), (38, 0)]
