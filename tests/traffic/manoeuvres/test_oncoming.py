"""Crossings only by oncoming vehicles, and by streams: who is inserted, who begins, and how fast."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.commitments import Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.intensity import ONCOMING
from advdiff_sumo.traffic.manoeuvres.oncoming import suited_crossings
from advdiff_sumo.traffic.manoeuvres.priority_traffic import (
    SHORT_GAPS,
    STREAM_GAP_S,
    conflict_points_m,
    next_of_stream,
    priority_approaches,
    turn_speed_mps,
)
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.schedule import insert_vehicles
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory
from tests.planners.encounters import CROSSING, Encounter, Scripted, bending, crossing, over
from tests.sim.nets import build

FROM_AHEAD = StagingMemory(only_oncoming=True)
LEFT, NORTH, STRAIGHT = ("west_in", "north_out"), ("south_in", "north_out"), ("west_in", "east_out")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("nets")


@pytest.fixture(scope="module")
def sign(folder: Path) -> RoadMap:
    return crossing(folder, "priority")


@pytest.fixture(scope="module")
def bend(folder: Path) -> RoadMap:
    return bending(folder)


def before(road: RoadMap, route: tuple[str, str], *others: tuple[tuple[str, str], float]) -> SituationView:
    """Return the target 33 m before the junction at 11 m/s, and *others*: (route, speed) 18 m before it."""
    cars = [
        Scripted(over(road, *way), road.lanes[f"{way[0]}_0"].length_m - away, speed)
        for way, speed, away in ((route, 11.0, 33.0), *((*other, 18.0) for other in others))
    ]
    seed = Encounter(road, cars[0], route, tuple(cars[1:])).scene()
    routes = (route, *(way for way, _ in others))
    movable = np.arange(len(cars)) > 0
    return SituationView.of(road, Scene(seed.history, 0, movable, routes, {}))


def test_a_target_that_turns_left_meets_only_oncoming_traffic(sign: RoadMap) -> None:
    """It turns from the west to the north. The east has priority; the south and the north must wait themselves."""
    approaches = list(priority_approaches(before(sign, LEFT), True, None, True))
    assert approaches
    assert {approach.way.present_lane.id for approach in approaches} == {"east_in_0"}
    assert {approach.way.links[0][1].direction for approach in approaches} == {"s"}


def test_in_left_hand_traffic_a_right_turn_meets_oncoming_traffic(folder: Path) -> None:
    nodes, edges = CROSSING[0].format(kind="priority"), CROSSING[1]
    road = RoadMap.read(build(folder, nodes, edges, name="left", lefthand=True))
    approaches = list(priority_approaches(before(road, ("west_in", "south_out")), True, None, True))
    assert {approach.way.present_lane.id for approach in approaches} == {"east_in_0"}
    assert not list(priority_approaches(before(road, LEFT), True, None, True))


@pytest.mark.parametrize("route", [NORTH, STRAIGHT])
def test_no_oncoming_vehicle_without_priority(route: tuple[str, str], sign: RoadMap) -> None:
    """From the south the main road is to the sides. On it, oncoming vehicles that turn across must wait."""
    view = before(sign, route)
    assert bool(list(priority_approaches(view, True))) == (route == NORTH)
    assert not list(priority_approaches(view, True, None, True))
    kept = Commitments.start(ONCOMING, np.random.default_rng(1), staged=6)
    assert insert_vehicles(view, kept)[0] == ()


def test_vehicles_on_a_bending_main_road_are_as_slow_as_the_bend(bend: RoadMap) -> None:
    """A quarter turn of 14.2 m has a radius of 9 m: 2.5 m/s² allow 4.75 m/s, a little more between the corners."""
    approaches = list(priority_approaches(before(bend, STRAIGHT), True, None, True))
    assert {approach.way.links[0][1].direction for approach in approaches} == {"l"}
    link = approaches[0].way.links[0][1]
    assert turn_speed_mps(bend, link) == pytest.approx(4.75, abs=0.6)
    assert max(approach.speed_mps for approach in approaches) <= turn_speed_mps(bend, link)
    straight = next(x for x in bend.lanes["east_in_0"].successors if x.direction == "s")
    assert turn_speed_mps(bend, straight) == np.inf


def test_only_oncoming_vehicles_begin(sign: RoadMap) -> None:
    ahead = before(sign, LEFT, (("east_in", "west_out"), 11.0))
    crossings = list(KINDS["crossing"](ahead, 1))
    assert crossings
    assert list(suited_crossings(ahead, crossings, FROM_AHEAD)) == crossings
    aside = before(sign, NORTH, (("east_in", "west_out"), 11.0))
    crossings = list(KINDS["crossing"](aside, 1))
    assert crossings
    assert list(suited_crossings(aside, crossings, FROM_AHEAD)) == []
    assert list(suited_crossings(aside, crossings, StagingMemory())) == crossings


@pytest.mark.parametrize(("speed_mps", "begins"), [(5.0, True), (11.0, False)])
@pytest.mark.parametrize("stage", [FROM_AHEAD, StagingMemory()])
def test_no_vehicle_begins_to_turn_too_fast_for_its_bend(
    stage: StagingMemory, speed_mps: float, begins: bool, bend: RoadMap
) -> None:
    view = before(bend, STRAIGHT, (("east_in", "south_out"), speed_mps))
    timed = list(suited_crossings(view, KINDS["crossing"](view, 1), stage))
    assert bool(timed) == begins
    assert all(m.profile.highest_mps < 6.0 for m in timed)


def test_the_next_one_of_a_stream_comes_a_short_gap_after_the_last(sign: RoadMap) -> None:
    view = before(sign, NORTH, (("west_in", "east_out"), 11.0))
    (approach,) = next_of_stream(view, 1)
    (last_line_m, link), (line_m, own_link) = view.ways[1].links[0], approach.way.links[0]
    assert own_link is link
    assert view.target is not None
    points = conflict_points_m(sign, view.target.way.links[0][1], link)
    assert points is not None
    after_s = (line_m + points[1]) / approach.speed_mps - (last_line_m + points[1]) / 11.0
    assert after_s == pytest.approx(STREAM_GAP_S, abs=0.01)


def test_no_stream_of_vehicles_that_must_wait_themselves(sign: RoadMap) -> None:
    """From the south nobody has priority over the main road."""
    assert not list(next_of_stream(before(sign, STRAIGHT, (NORTH, 11.0)), 1))


def test_a_stream_is_inserted_while_its_vehicles_cross(sign: RoadMap) -> None:
    view = before(sign, NORTH, (("west_in", "east_out"), 11.0))
    history = replace(view.scene.history, ids=("target", "staged-0"))
    view = SituationView.of(sign, replace(view.scene, history=history))
    kept = Commitments.start(SHORT_GAPS, np.random.default_rng(1), staged=6)
    crosses = Commitment("crossing", SpeedProfile(0.0, 1.0), 0.0, 0.0, False)
    kept = replace(kept, stage=replace(kept.stage, count=1), active={"staged-0": crosses})
    (newcomer,), after = insert_vehicles(view, kept)
    assert (newcomer.name, after.stage.count) == ("staged-1", 2)
    alone = replace(kept, stage=replace(kept.stage, streams=False))
    assert insert_vehicles(view, alone)[0] == ()


def test_vehicles_of_a_stream_keep_their_speed(sign: RoadMap) -> None:
    view = before(sign, NORTH, (("west_in", "east_out"), 11.0))
    crossings = list(KINDS["crossing"](view, 1))
    assert list(suited_crossings(view, crossings, StagingMemory())) == crossings
    (steady,) = suited_crossings(view, crossings, StagingMemory(streams=True))
    assert (steady.profile.first_mps2, steady.profile.then_mps2) == (0.0, 0.0)


@pytest.mark.parametrize("attack", [ONCOMING, SHORT_GAPS])
def test_records_call_it_a_crossing(attack: str) -> None:
    kept = Commitments.start(attack, np.random.default_rng(1), staged=6)
    assert tuple(kept.weights) == ("crossing",)
    assert (kept.stage.only_oncoming, kept.stage.streams) == (attack == ONCOMING, attack == SHORT_GAPS)
    assert not Commitments.start("crossing", np.random.default_rng(1), staged=6).stage.only_oncoming
