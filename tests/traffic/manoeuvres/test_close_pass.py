"""A vehicle that passes the target on the lane beside, close to the line: where it drives, when it begins and ends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.close_pass import (
    SLOW_LEADER,
    close_pass,
    continued_pass,
    pass_sides,
    slow_leaders,
)
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.repertoire import CLOSE_PASSING
from advdiff_sumo.traffic.manoeuvres.schedule import update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory, insert_newcomers
from tests.sim.nets import build
from tests.traffic.manoeuvres.scenes import lane_alone, scene_on, shifted, view_of

TARGET = {"target": (0, 100.0, 20.0)}


def beside(ahead_m: float, speed_mps: float) -> dict[str, tuple[int, float, float]]:
    """Return a vehicle on the lane to the left, *ahead_m* of the target."""
    return {"other": (1, 100.0 + ahead_m, speed_mps)}


@pytest.mark.parametrize(
    ("target_left_m", "place_m"),
    [
        (0.0, -0.7),  # lanes of 3.5 m, cars of 1.8 m: 0.15 m to the line
        (0.5, -0.5),  # 3 m apart, 1.2 m between the boxes: 0.7 m remain
        (1.5, 0.5),  # the target is over the line by 0.65 m: the other keeps its distance
    ],
)
def test_it_keeps_close_to_the_line_but_clear_of_the_target(
    motorway: RoadMap, target_left_m: float, place_m: float
) -> None:
    view = shifted(view_of(motorway, **TARGET, **beside(-6.0, 21.0)), 0, target_left_m)
    passing = next(iter(close_pass(view, 1)))
    assert passing.way.keeps_left_m == pytest.approx(place_m, abs=1e-3)
    xy, _ = passing.way.poses(21.0 * CHECK_TIMES_S, CHECK_TIMES_S)
    assert float(view.ways[1].line.project(xy[-1])[1]) == pytest.approx(place_m, abs=1e-3)


def test_nobody_passes_a_target_that_takes_up_the_lane_beside(motorway: RoadMap) -> None:
    """2.3 m to the left the boxes are 0.6 m apart across if the other gives way by 1.2 m: it can by 0.7 m."""
    view = shifted(view_of(motorway, **TARGET, **beside(-6.0, 21.0)), 0, 2.3)
    assert not list(close_pass(view, 1))


@pytest.mark.parametrize(
    ("ahead_m", "speed_mps", "positioning", "wish_mps"),
    [
        (-30.0, 20.0, True, 25.0),  # 25.5 m gap: at most 5 m/s faster
        (-12.0, 20.0, True, 22.4),  # 7.5 m gap, 3.5 m more than at the beginning of the pass: 1 + 0.4 · 3.5
        (-6.0, 21.0, False, 21.0),
        (0.0, 21.5, False, 21.0),
        (0.0, 19.5, False, 19.0),  # the target passes it
        (12.0, 20.0, True, 17.6),
    ],
)
def test_it_comes_alongside_and_passes_with_a_metre_per_second(
    motorway: RoadMap, ahead_m: float, speed_mps: float, positioning: bool, wish_mps: float
) -> None:
    passing = next(iter(close_pass(view_of(motorway, **TARGET, **beside(ahead_m, speed_mps)), 1)))
    assert passing.kind == CLOSE_PASSING
    assert passing.is_positioning == positioning
    reached = speed_mps + 0.8 * passing.profile.first_mps2
    assert reached == pytest.approx(np.clip(wish_mps, speed_mps - 1.6, speed_mps + 1.6))


def test_it_does_not_overtake_above_the_limit(motorway: RoadMap) -> None:
    limit = view_of(motorway, **TARGET, **beside(-6.0, 21.0)).ways[1].lane.speed_mps
    at_limit = view_of(motorway, target=(0, 100.0, limit), **beside(-6.0, limit))
    assert not list(close_pass(at_limit, 1))
    ahead = view_of(motorway, target=(0, 100.0, limit), **beside(6.0, limit))
    assert [m.is_positioning for m in close_pass(ahead, 1)] == [False]  # it lets the target pass


def test_it_ends_beyond_the_target_and_where_the_target_enters_the_lane_ahead(motorway: RoadMap) -> None:
    """Cars of 4.5 m: it is 2 m beyond the target after 6.5 m."""
    assert continued_pass(view_of(motorway, **TARGET, **beside(6.0, 21.0)), 1) is not None
    assert continued_pass(view_of(motorway, **TARGET, **beside(7.0, 21.0)), 1) is None
    behind, level = (view_of(motorway, **TARGET, **beside(ahead_m, 21.0)) for ahead_m in (-6.0, -2.0))
    assert continued_pass(shifted(behind, 0, 0.8, 0.8), 1) is None
    assert continued_pass(shifted(level, 0, 0.8, 0.8), 1) is not None  # too late to let it in
    assert continued_pass(shifted(behind, 0, 0.8), 1) is not None
    between = view_of(motorway, target=(1, 100.0, 20.0), other=(2, 94.0, 21.0))
    assert continued_pass(shifted(between, 0, 0.8, 0.8), 1) is None
    assert continued_pass(shifted(between, 0, -0.8, -0.8), 1) is not None  # it changes to the other side


@pytest.mark.parametrize("ahead_m", [-16.0, -7.0])
def test_nobody_comes_alongside_while_the_target_changes_to_that_lane(
    motorway: RoadMap, ahead_m: float
) -> None:
    view = view_of(motorway, **TARGET, **beside(ahead_m, 21.0))
    assert not list(close_pass(shifted(view, 0, 0.8, 0.8), 1))
    assert list(close_pass(shifted(view, 0, 0.8), 1))  # it is off its centre line, but changes no lane


def test_the_place_counts_from_the_target_also_where_a_new_road_begins_between_them(tmp_path: Path) -> None:
    """The target, over the line by 0.55 m, is still before the road on which the other is: it keeps its distance."""
    nodes = "".join(f'<node id="{name}" x="{x}" y="0"/>' for name, x in (("W", 0), ("M", 300), ("E", 600)))
    lanes = 'numLanes="2" speed="25" width="3.5"'
    edges = f'<edge id="WM" from="W" to="M" {lanes}/><edge id="ME" from="M" to="E" {lanes}/>'
    road = RoadMap.read(build(tmp_path, f"<nodes>{nodes}</nodes>", f"<edges>{edges}</edges>"))
    before, beyond = road.lanes["WM_0"], road.lanes["ME_1"]
    cars = {"target": (before, before.length_m - 1.5, 20.0), "other": (beyond, 1.0, 21.0)}
    scene = replace(scene_on(cars), routes=(("WM", "ME"), ("ME",)))
    view = shifted(SituationView.of(road, scene), 0, 1.4)
    passing = continued_pass(view, 1)
    assert passing is not None
    assert passing.way.keeps_left_m == pytest.approx(0.4, abs=1e-3)


def test_the_nearest_vehicle_on_the_overtaking_side_passes(motorway: RoadMap, tmp_path: Path) -> None:
    cars = {"left": (2, 90.0, 21.0), "far": (2, 75.0, 21.0), "right": (0, 95.0, 21.0)}
    view = view_of(motorway, target=(1, 100.0, 20.0), **cars)
    assert pass_sides(view) == ["left", "right"]
    assert [bool(list(close_pass(view, row))) for row in (1, 2, 3)] == [True, False, False]
    cars["left"] = (2, 108.0, 24.0)  # it has passed
    view = view_of(motorway, target=(1, 100.0, 20.0), **cars)
    assert [bool(list(close_pass(view, row))) for row in (1, 2, 3)] == [False, True, False]
    nodes = '<nodes><node id="W" x="0" y="0"/><node id="E" x="600" y="0"/></nodes>'
    edges = '<edges><edge id="WE" from="W" to="E" numLanes="3" speed="25"/></edges>'
    lefthand = RoadMap.read(build(tmp_path, nodes, edges, lefthand=True))
    scene = scene_on({"target": (lefthand.lanes["WE_1"], 100.0, 20.0)})
    assert pass_sides(SituationView.of(lefthand, scene)) == ["right", "left"]


def test_the_leader_slows_once_a_vehicle_is_alongside(motorway: RoadMap) -> None:
    """The limit is 33.33 m/s, half of it 16.7: at 1.5 m/s² it is there 4.4 s after 23.3 m/s."""
    leader = {"leader": (0, 140.0, 23.3)}
    alone = slow_leaders(view_of(motorway, **TARGET, **leader), ())[0]
    assert (alone.kind, alone.profile.first_mps2) == (SLOW_LEADER, pytest.approx(2.0))  # to 0.8 of the limit
    view = view_of(motorway, **TARGET, **leader, **beside(-6.0, 21.0))
    slow = slow_leaders(view, ())[0]
    limit = slow.way.lane.speed_mps
    assert slow.profile.first_mps2 == -1.5
    assert slow.profile.lowest_mps == pytest.approx(0.5 * limit)
    assert slow_leaders(view, (1,)) == []
    assert slow_leaders(view_of(motorway, **TARGET, **beside(-6.0, 21.0)), ()) == []


def test_both_are_driven_and_recorded(motorway: RoadMap) -> None:
    memory = Commitments.start(CLOSE_PASSING, np.random.default_rng(0))
    cars = {"leader": (0, 140.0, 20.0), **beside(-6.0, 21.0)}
    driven, memory = update_manoeuvres(view_of(motorway, 5.0, **TARGET, **cars), memory, 2, 8.0)
    assert [m.kind for m in driven] == [SLOW_LEADER]  # the other has just come into view
    driven, memory = update_manoeuvres(view_of(motorway, 8.0, **TARGET, **cars), memory, 2, 8.0)
    assert {m.kind for m in driven} == {CLOSE_PASSING, SLOW_LEADER}
    assert memory.attacking == ("other",)
    assert memory.manoeuvres == {"other": CLOSE_PASSING, "leader": SLOW_LEADER}
    driven, memory = update_manoeuvres(view_of(motorway, 8.5, **TARGET, **cars), memory, 2, 8.0)
    assert memory.attacking == ("other",)
    past = {**cars, **beside(7.0, 21.0)}
    driven, memory = update_manoeuvres(view_of(motorway, 9.0, **TARGET, **past), memory, 2, 8.0)
    assert memory.attacking == ()
    assert memory.rested_s == {"other": 17.0}


def test_a_leader_and_a_vehicle_to_pass_are_inserted(motorway: RoadMap) -> None:
    newcomers, _ = insert_newcomers(view_of(motorway, **TARGET), StagingMemory(most=6), (CLOSE_PASSING,))
    places = [view_of(motorway, **TARGET).ways[0].line.project(n.xy_m) for n in newcomers]
    passing, leader = [(float(s) - 100.0, float(left)) for s, left in places]
    assert passing == pytest.approx((-19.0, 3.5), abs=0.05)
    assert leader == pytest.approx((38.0, 0.0), abs=0.05)  # 1.5 s and 8 m ahead
    with_one = view_of(motorway, **TARGET, **beside(-30.0, 20.0))
    assert len(insert_newcomers(with_one, StagingMemory(most=6), (CLOSE_PASSING,))[0]) == 1
    one_left = StagingMemory(most=6, count=5)
    assert len(insert_newcomers(view_of(motorway, **TARGET), one_left, (CLOSE_PASSING,))[0]) == 1


def test_there_is_no_pass_without_a_lane_beside(downtown: RoadMap) -> None:
    lane = lane_alone(downtown)
    view = SituationView.of(downtown, scene_on({"target": (lane, 5.0, 10.0), "leader": (lane, 28.0, 10.0)}))
    assert pass_sides(view) == []
    assert slow_leaders(view, ()) == []
    alone = SituationView.of(downtown, scene_on({"target": (lane, 5.0, 10.0)}))
    assert insert_newcomers(alone, StagingMemory(most=6), (CLOSE_PASSING,))[0] == ()
