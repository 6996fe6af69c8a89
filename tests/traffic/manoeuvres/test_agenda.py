"""Turns of the kinds in an episode of "any": a turn ends in time, or at once if there is no room for the kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.manoeuvres.agenda import TURN_S, Agenda
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.schedule import insert_vehicles
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from tests.traffic.manoeuvres.scenes import scene_on, view_of

ORDER = ("crossing", "cut-in", "hard-stop")


def later(view: SituationView, time_s: float) -> SituationView:
    history = replace(view.scene.history, t0_s=view.scene.history.t0_s + time_s)
    return SituationView(view.road, replace(view.scene, history=history), view.ways)


def test_an_impossible_kind_loses_its_turn(motorway: RoadMap) -> None:
    """A motorway has no crossings, but a lane beside for a cut-in. A leader leaves no room for a vehicle to cut in."""
    free = view_of(motorway, target=(0, 50.0, 20.0))
    assert Agenda(ORDER).updated(free).now == "cut-in"
    behind = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 80.0, 20.0))
    assert Agenda(ORDER).updated(behind).now == "hard-stop"


def test_a_turn_ends_in_time(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0))
    agenda = Agenda(ORDER).updated(view)
    assert agenda.updated(later(view, TURN_S - 0.5)).now == "cut-in"
    after = agenda.updated(later(view, TURN_S))
    assert after.now == "hard-stop"
    assert after.since_s == TURN_S
    assert sorted(after.order) == sorted(ORDER)


def test_a_single_kind_has_no_turns(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0))
    begun = Commitments.start("crossing", np.random.default_rng(0), 3)
    assert begun.agenda.updated(view).now == ""
    assert begun.insertable_kinds(view) == ("crossing",)


def test_every_order_contains_every_kind() -> None:
    drawn = [Agenda.draw(np.random.default_rng(k)).order for k in range(40)]
    assert {tuple(sorted({*order} - {"cut-out", "queue"})) for order in drawn} == {tuple(sorted(ORDER))}
    assert {order[0] for order in drawn} == {"crossing", "cut-in", "cut-out"}
    assert {order[-1] for order in drawn} == {"hard-stop"}
    assert {order.index("cut-out") for order in drawn if "cut-out" in order} == {0}
    assert {order.index("queue") for order in drawn if "queue" in order} == {1}
    assert sum("queue" in order for order in drawn) < sum("cut-out" in order for order in drawn)


def test_a_cut_out_has_its_turn_only_at_the_beginning(motorway: RoadMap) -> None:
    """There is room for it unless the lane beside is taken. It has no second turn."""
    view = view_of(motorway, target=(0, 50.0, 9.0))
    begun = Agenda(("cut-out", *ORDER)).updated(view)
    assert begun.now == "cut-out"
    assert begun.updated(later(view, TURN_S - 0.5)).now == "cut-out"
    after = begun.updated(later(view, TURN_S))
    assert "cut-out" not in after.order
    assert after.now == "cut-in"
    fast = view_of(motorway, target=(0, 50.0, 20.0))
    assert Agenda(("cut-out", *ORDER)).updated(fast).now == "cut-out"
    narrow = view_of(motorway, target=(0, 50.0, 9.0), beside=(1, 90.0, 9.0))
    assert Agenda(("cut-out", *ORDER)).updated(narrow).now == "cut-in"


def test_a_queue_has_its_turn_if_no_cut_out_is_possible(motorway: RoadMap) -> None:
    """This is so beside another vehicle, and only at the beginning. Behind a leader there is room for neither."""
    narrow = view_of(motorway, target=(0, 50.0, 20.0), beside=(1, 90.0, 20.0))
    begun = Agenda(("cut-out", "queue", *ORDER)).updated(narrow)
    assert begun.now == "queue"
    assert begun.updated(later(narrow, TURN_S)).order[0] == "cut-in"
    free = view_of(motorway, target=(0, 50.0, 20.0))
    assert Agenda(("cut-out", "queue", *ORDER)).updated(free).now == "cut-out"
    behind = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 80.0, 20.0))
    assert Agenda(("cut-out", "queue", *ORDER)).updated(behind).now == "hard-stop"


def approach(road: RoadMap, to_line_m: float, speed_mps: float) -> SituationView:
    """Return a target alone, *to_line_m* before a stop line without lights where it must yield."""
    link = next(
        link
        for lane in road.lanes.values()
        for link in lane.successors
        if not lane.is_internal and link.tls_id is None and link.state == "m" and lane.length_m > 110.0
    )
    lane = road.lanes[link.from_lane]
    scene = scene_on({"target": (lane, lane.length_m - to_line_m, speed_mps)})
    route = (lane.edge_id, road.lanes[link.to_lane].edge_id)
    return SituationView.of(road, replace(scene, routes=(route,)))


@pytest.mark.parametrize(("speed_mps", "crossing_first"), [(8.0, False), (12.0, True)])
def test_a_junction_where_the_target_has_to_yield_comes_first(
    downtown: RoadMap, speed_mps: float, crossing_first: bool
) -> None:
    """The foresight is 8 s. 90 m before the line it does not cover the way at 8 m/s (64 m), so a leader is inserted."""
    order = ("hard-stop", "cut-in", "crossing")
    view = approach(downtown, 90.0, speed_mps)
    agenda = Agenda(order).updated(view)
    assert agenda.order == (("crossing", "hard-stop", "cut-in") if crossing_first else order)
    kept = replace(Commitments.start("any", np.random.default_rng(0), 6), agenda=agenda)
    leaders = [newcomer for newcomer in insert_vehicles(view, kept)[0] if newcomer.speed_mps == speed_mps]
    assert len(leaders) == (not crossing_first)
