"""Crossing somebody who must let one pass: when it can be, what it sees coming, and whether it has a way out."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.answers import notices_no_stop_s, trapped_share
from advdiff_sumo.traffic.manoeuvres.commitments import Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS, continued_crossings
from advdiff_sumo.traffic.manoeuvres.schedule import advance
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, SpeedProfile
from tests.planners.encounters import Encounter, Scripted, crossing, over
from tests.traffic.manoeuvres.scenes import view_of

NORTH = ("south_in", "north_out")
SIZE_M = np.array([[4.6, 1.8]])


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    return crossing(tmp_path_factory.mktemp("nets"), "traffic_light")


def at_the_light(road: RoadMap, letter: str, target_m: float, others_m: float) -> SituationView:
    """Return the target northward at 10 m/s and somebody from the east, so far from where their lanes begin."""
    ways = over(road, *NORTH), over(road, "east_in", "west_out")
    encounter = Encounter(
        road, Scripted(ways[0], target_m, 10.0), NORTH, (Scripted(ways[1], others_m, 10.0),)
    )
    seed = encounter.scene()
    links = [link for link in road.links.values() if link.tls_id is not None and link.tls_index is not None]
    letters = [letter if link.from_lane in ways[0] else "G" for link in sorted(links, key=_place)]
    routes = NORTH, ("east_in", "west_out")
    lights = {str(links[0].tls_id): "".join(letters)}
    return SituationView.of(road, Scene(seed.history, 0, np.array([False, True]), routes, lights))


def _place(link: Link) -> int:
    return int(link.tls_index or 0)


@pytest.mark.parametrize(("leads_mps", "alone"), [(10.0, True), (2.0, False)])
def test_who_drives_ahead_is_gone_by_then(motorway: RoadMap, leads_mps: float, alone: bool) -> None:
    """At 10 m/s, gaining a little, the target has driven 60 m after 5.3 s; a leader 20 m ahead has 1 s before."""
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 70.0, leads_mps))
    assert not view.is_clear_to(60.0)
    assert view.is_clear_on_arrival(60.0) is alone


def test_when_it_is_seen_that_somebody_will_not_stop() -> None:
    """At 9 m/s 4.5 m/s² need 9 m: with 20 m to go that is after 11 m, 1.22 s, seen at 1.25 s and 0.25 s later."""
    steady = np.full(len(CHECK_TIMES_S), 9.0)
    driven_m = 9.0 * CHECK_TIMES_S
    assert notices_no_stop_s(20.0, 9.0, driven_m, steady) == 1.5
    assert notices_no_stop_s(8.9, 9.0, driven_m, steady) == 0.0
    stops = np.maximum(9.0 - 3.0 * CHECK_TIMES_S, 0.0)
    assert notices_no_stop_s(20.0, 9.0, 4.5 * CHECK_TIMES_S, stops) == np.inf


def test_a_way_out(motorway: RoadMap) -> None:
    """Somebody stands across the lane: at 10 m/s full braking takes 6.25 m, and nobody hurries past.

    Noticed now, 9 m of room are enough and 4 m are not; noticed after 0.5 s, 5 m later, neither are.
    """
    view = view_of(motorway, target=(0, 50.0, 10.0))
    target = view.target
    assert target is not None
    for room_m, notices_s, share in ((9.0, 0.0, 0.0), (4.0, 0.0, 1.0), (9.0, 0.5, 1.0)):
        place = target.way.line.at(target.way.lane.s_m + 0.5 * target.size_m[0] + room_m + 0.9)
        xy = np.broadcast_to(place[0], (1, len(CHECK_TIMES_S), 2))
        yaw = np.full((1, len(CHECK_TIMES_S)), float(place[1]) + 0.5 * np.pi)
        assert trapped_share(target, xy, yaw, SIZE_M, np.array([notices_s])) == [share], room_m


def test_who_is_never_noticed_leaves_no_question(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 10.0))
    assert view.target is not None
    xy, yaw = np.zeros((1, len(CHECK_TIMES_S), 2)), np.zeros((1, len(CHECK_TIMES_S)))
    assert trapped_share(view.target, xy, yaw, SIZE_M, np.array([np.inf])) == [0.0]


def test_somebody_hesitates_before_a_red_light_of_the_target_alone(light: RoadMap) -> None:
    red, green = (at_the_light(light, letter, 260.0, 250.0) for letter in "rg")
    hesitates = [m for m in KINDS["crossing"](red, 1) if m.profile.then_mps2 > 0.0]
    assert hesitates
    assert not [m for m in KINDS["crossing"](green, 1) if m.profile.then_mps2 > 0.0]


def test_nobody_hurries_at_a_target_that_it_lets_pass(light: RoadMap) -> None:
    """The target is on the junction: who has begun to cross keeps its speed or slows, and nobody begins."""
    passing = at_the_light(light, "g", 299.0, 270.0)
    assert passing.target_link is not None
    assert not list(KINDS["crossing"](passing, 1))
    gains = {m.profile.first_mps2 for m in continued_crossings(passing, 1)}
    assert gains == {0.0, -1.0, -2.0}
    assert {m.profile.first_mps2 for m in continued_crossings(at_the_light(light, "r", 299.0, 270.0), 1)} >= {
        1.0,
        2.0,
    }


def test_who_crosses_follows_a_target_that_has_come_out_ahead(motorway: RoadMap) -> None:
    """On one lane 20 m apart: to go on with the manoeuvre would be to run into the rear of the target."""
    begun = Commitment("crossing", SpeedProfile(), 0.0, 0.0, sets_up=False)
    for other_m, goes_on in ((30.0, False), (70.0, True)):
        view = view_of(motorway, target=(0, 50.0, 5.0), other=(0, other_m, 10.0))
        driven, _ = advance(view, Commitments({"crossing": 1.0}, {"other": begun}), 1, 8.0)
        assert bool(driven) is goes_on
