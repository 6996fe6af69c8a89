"""The vehicle behind the target brakes for what the target should brake for, on a straight lane of the motorway."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.commitments import Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.follower import (
    FOLLOWS,
    braking_behind,
    still_follows,
)
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.schedule import update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from tests.traffic.manoeuvres.scenes import LENGTH_M, scene_on, view_of


def behind(road: RoadMap, gap_m: float, speed_mps: float = 10.0) -> SituationView:
    """Return a target at 10 m/s with a vehicle *gap_m* behind it."""
    return view_of(road, target=(0, 80.0, 10.0), follower=(0, 80.0 - LENGTH_M - gap_m, speed_mps))


@pytest.mark.parametrize(("gap_m", "braking"), [(20.0, 2.0), (10.0, 4.0), (2.0, None)])
def test_the_mildest_braking_behind_a_careful_driver(
    motorway: RoadMap, gap_m: float, braking: float | None
) -> None:
    """The careful driver accelerates for 0.75 s to 10.4 m/s (7.6 m), then stops with 7.59 m/s² in 7.1 m.

    The follower first drives on for 7.5 m. Less a margin of 1 m, gaps of 20, 10 and 2 m leave 26.2, 16.2 and 8.2 m.
    These require 1.9, 3.1 and 6.1 m/s²; whole values up to 6 are tried.
    """
    brakes = braking_behind(behind(motorway, gap_m), 1, 0.0)
    assert (None if brakes is None else -brakes.profile.then_mps2) == braking


def test_the_follower_brakes_later_if_the_target_perceives_later(motorway: RoadMap) -> None:
    brakes = braking_behind(behind(motorway, 20.0), 1, 1.5)
    assert brakes is not None
    assert brakes.kind == FOLLOWS
    assert brakes.profile.switch_s == 2.25


def test_the_follower_is_the_next_vehicle_behind_on_the_same_lane(motorway: RoadMap) -> None:
    view = view_of(
        motorway,
        target=(0, 100.0, 10.0),
        far=(0, 60.0, 10.0),
        near=(0, 80.0, 10.0),
        beside=(1, 92.0, 10.0),
        leader=(0, 120.0, 10.0),
    )
    assert view.follower == view.scene.history.index["near"]
    assert view_of(motorway, target=(0, 100.0, 10.0), leader=(0, 120.0, 10.0)).follower is None


def test_sumo_drives_the_follower_again_if_the_target_brakes_sooner(motorway: RoadMap) -> None:
    """Both drive at 10 m/s, 2 m apart. Braking at once with 4 m/s² is enough if the target keeps its speed.

    A target that slowed by 3 m/s in the last half second stops in 8.3 m, the follower only in 12.5 m.
    """
    view = behind(motorway, 2.0)
    brakes = Manoeuvre(FOLLOWS, 1, view.ways[1], SpeedProfile(then_mps2=-4.0))
    assert still_follows(view, brakes)
    view.scene.history.speed_mps[0, -2] = 13.0
    assert not still_follows(view, brakes)


def advanced(road: RoadMap, gap_m: float) -> tuple[list[Manoeuvre], Commitments]:
    """Return the manoeuvres and the memory at 3 s, with a leader 12 m ahead and a follower *gap_m* behind."""
    cars = {"leader": (0, 80.0 + LENGTH_M + 12.0, 10.0), "follower": (0, 80.0 - LENGTH_M - gap_m, 10.0)}
    kept = Commitments.start("hard-stop", np.random.default_rng(0))
    for time_s in (0.0, 3.0):
        view = view_of(road, time_s=time_s, target=(0, 80.0, 10.0), **cars)
        driven, kept = update_manoeuvres(view, kept, 2, 8.0)
    return driven, kept


def test_the_follower_brakes_when_the_leader_stops(motorway: RoadMap) -> None:
    driven, kept = advanced(motorway, 15.0)
    assert {m.kind: m.row for m in driven} == {"hard-stop": 1, FOLLOWS: 2}
    assert kept.attacking == ("leader",)
    assert kept.manoeuvres == {"leader": "hard-stop"}
    stand = view_of(
        motorway, time_s=6.0, target=(0, 90.0, 0.0), leader=(0, 97.0, 0.0), follower=(0, 80.0, 3.0)
    )
    driven, kept = update_manoeuvres(stand, kept, 2, 8.0)
    assert driven == []
    assert kept.active == {}


def test_no_leader_stops_before_a_target_that_is_followed_too_closely(motorway: RoadMap) -> None:
    driven, kept = advanced(motorway, 2.0)
    assert [m for m in driven if not m.is_positioning] == []
    assert kept.attacking == ()


@pytest.mark.parametrize(("to_line_m", "brakes"), [(14.0, False), (6.0, True)])
def test_the_follower_brakes_once_a_yielding_target_must_brake(
    downtown: RoadMap, to_line_m: float, brakes: bool
) -> None:
    """At 8 m/s, a target 14 m before the line is at the conflict point in 3.75 s, one 6 m before it in under 3 s."""
    link = next(
        link
        for lane in downtown.lanes.values()
        for link in lane.successors
        if not lane.is_internal and link.tls_id is None and link.state == "m" and lane.length_m > 90.0
    )
    lane = downtown.lanes[link.from_lane]
    junction = downtown.junctions[link.junction_id]
    first = next(
        other
        for name in junction.incoming_lanes
        if name in downtown.lanes
        for other in downtown.lanes[name].successors
        if other.junction_id == junction.id and downtown.must_yield(link, other) and other.direction == "s"
    )
    there = downtown.lanes[first.from_lane]
    cars = {
        "target": (lane, lane.length_m - to_line_m, 8.0),
        "other": (there, max(there.length_m - to_line_m, 5.0), 8.0),
        "follower": (lane, lane.length_m - to_line_m - 20.0, 8.0),
    }
    scene = scene_on(cars, 4.0)
    to = downtown.lanes[link.to_lane].edge_id
    across = (there.edge_id, downtown.lanes[first.to_lane].edge_id)
    view = SituationView.of(downtown, replace(scene, routes=((lane.edge_id, to), across, (lane.edge_id, to))))
    crosses = Commitment("crossing", SpeedProfile(), 3.5, 4.0, is_positioning=False)
    kept = Commitments({"crossing": 1.0}, active={"other": crosses}, since_s={"other": 0.0})
    driven, _ = update_manoeuvres(view, kept, 2, 8.0)
    assert "crossing" in {m.kind for m in driven}
    assert (FOLLOWS in {m.kind for m in driven}) is brakes
