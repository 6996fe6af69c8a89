"""Crossings with priority: when they are possible, when the target notices them, and whether it can escape."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.commitments import Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS, continued_crossings
from advdiff_sumo.traffic.manoeuvres.required_braking import notices_no_stop_s, trapped_share
from advdiff_sumo.traffic.manoeuvres.schedule import update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, SpeedProfile
from tests.planners.encounters import Encounter, Scripted, crossing, over
from tests.traffic.manoeuvres.scenes import view_of

NORTH = ("south_in", "north_out")
SIZE_M = np.array([[4.6, 1.8]])


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> RoadMap:
    return crossing(tmp_path_factory.mktemp("nets"), "traffic_light")


def at_the_light(road: RoadMap, letter: str, target_m: float, other_m: float) -> SituationView:
    """Return the target northward at 10 m/s and a vehicle from the east, at these distances along their lanes."""
    ways = over(road, *NORTH), over(road, "east_in", "west_out")
    encounter = Encounter(road, Scripted(ways[0], target_m, 10.0), NORTH, (Scripted(ways[1], other_m, 10.0),))
    seed = encounter.scene()
    links = [link for link in road.links.values() if link.tls_id is not None and link.tls_index is not None]
    letters = [letter if link.from_lane in ways[0] else "G" for link in sorted(links, key=_place)]
    routes = NORTH, ("east_in", "west_out")
    lights = {str(links[0].tls_id): "".join(letters)}
    return SituationView.of(road, Scene(seed.history, 0, np.array([False, True]), routes, lights))


def _place(link: Link) -> int:
    return int(link.tls_index or 0)


@pytest.mark.parametrize(("leader_mps", "is_clear"), [(10.0, True), (2.0, False)])
def test_a_leader_has_left_when_the_target_arrives(
    motorway: RoadMap, leader_mps: float, is_clear: bool
) -> None:
    """From 10 m/s, with a little acceleration, 60 m take 5.3 s. A leader 20 m ahead must have left 1 s before."""
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 70.0, leader_mps))
    assert not view.is_clear_to(60.0)
    assert view.is_clear_on_arrival(60.0) is is_clear


def test_when_the_target_notices_that_a_vehicle_will_not_stop() -> None:
    """From 9 m/s, 4.5 m/s² need 9 m: with 20 m to go, after 11 m or 1.22 s. It is noticed 0.25 s after 1.25 s."""
    steady = np.full(len(CHECK_TIMES_S), 9.0)
    driven_m = 9.0 * CHECK_TIMES_S
    assert notices_no_stop_s(20.0, 9.0, driven_m, steady) == 1.5
    assert notices_no_stop_s(8.9, 9.0, driven_m, steady) == 0.0
    stops = np.maximum(9.0 - 3.0 * CHECK_TIMES_S, 0.0)
    assert notices_no_stop_s(20.0, 9.0, 4.5 * CHECK_TIMES_S, stops) == np.inf


def test_whether_the_target_can_escape(motorway: RoadMap) -> None:
    """A vehicle stands across the lane. From 10 m/s full braking takes 6.25 m; hurrying does not help.

    Noticed now, 9 m suffice and 4 m do not. Noticed 0.5 s and 5 m later, 9 m do not suffice either.
    """
    view = view_of(motorway, target=(0, 50.0, 10.0))
    target = view.target
    assert target is not None
    for room_m, notices_s, share in ((9.0, 0.0, 0.0), (4.0, 0.0, 1.0), (9.0, 0.5, 1.0)):
        place = target.way.line.at(target.way.lane.s_m + 0.5 * target.size_m[0] + room_m + 0.9)
        xy = np.broadcast_to(place[0], (1, len(CHECK_TIMES_S), 2))
        yaw = np.full((1, len(CHECK_TIMES_S)), float(place[1]) + 0.5 * np.pi)
        assert trapped_share(target, xy, yaw, SIZE_M, np.array([notices_s])) == [share], room_m


def test_a_vehicle_that_is_never_noticed_traps_no_target(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 10.0))
    assert view.target is not None
    xy, yaw = np.zeros((1, len(CHECK_TIMES_S), 2)), np.zeros((1, len(CHECK_TIMES_S)))
    assert trapped_share(view.target, xy, yaw, SIZE_M, np.array([np.inf])) == [0.0]


def test_a_vehicle_hesitates_only_if_the_target_has_a_red_light(light: RoadMap) -> None:
    red, green = (at_the_light(light, letter, 260.0, 250.0) for letter in "rg")
    hesitates = [m for m in KINDS["crossing"](red, 1) if m.profile.then_mps2 > 0.0]
    assert hesitates
    assert not [m for m in KINDS["crossing"](green, 1) if m.profile.then_mps2 > 0.0]


def test_no_vehicle_accelerates_towards_a_target_on_the_junction(light: RoadMap) -> None:
    """A vehicle that has begun to cross keeps its speed or slows, and none begins."""
    passing = at_the_light(light, "g", 299.0, 270.0)
    assert passing.target_link is not None
    assert not list(KINDS["crossing"](passing, 1))
    accels = {m.profile.first_mps2 for m in continued_crossings(passing, 1)}
    assert accels == {0.0, -1.0, -2.0}
    assert {m.profile.first_mps2 for m in continued_crossings(at_the_light(light, "r", 299.0, 270.0), 1)} >= {
        1.0,
        2.0,
    }


def test_a_crossing_ends_once_the_target_drives_ahead_on_the_same_lane(motorway: RoadMap) -> None:
    """They are 20 m apart on one lane. A crossing vehicle that went on would run into the rear of the target."""
    begun = Commitment("crossing", SpeedProfile(), 0.0, 0.0, is_positioning=False)
    for other_m, goes_on in ((30.0, False), (70.0, True)):
        view = view_of(motorway, target=(0, 50.0, 5.0), other=(0, other_m, 10.0))
        driven, _ = update_manoeuvres(view, Commitments({"crossing": 1.0}, {"other": begun}), 1, 8.0)
        assert bool(driven) is goes_on
