"""Which manoeuvres are lawful, the braking they require, and the choice, on a straight lane of the motorway."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.traffic.manoeuvres.choice import rank
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.required_braking import INSUFFICIENT_MPS2, needed_braking
from advdiff_sumo.traffic.manoeuvres.schedule import update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, SpeedProfile
from tests.traffic.manoeuvres.scenes import LENGTH_M, scene_on, view_of


def needed(view: SituationView, *manoeuvres: Manoeuvre, perceived_s: float = 0.0) -> list[float]:
    speed = np.array([view.speed(m.row) for m in manoeuvres])
    futures = futures_of_manoeuvres(manoeuvres, speed)
    assert view.target is not None
    size = view.scene.history.size_m[[m.row for m in manoeuvres]]
    times_s = np.full(len(manoeuvres), perceived_s)
    return needed_braking(view.target, futures.xy_m, futures.yaw_rad, size, times_s).tolist()


def test_required_braking_behind_a_stopping_leader(motorway: RoadMap) -> None:
    """Both at 20 m/s; the leader stops in 20²/(2·8) = 25 m.

    The target accelerates at 0.5 m/s² for 0.75 s: 15.1 m, up to 20.4 m/s. Less 0.3 m of clearance, gaps of 40, 30, 22
    and 10 m leave 49.6, 39.6, 31.6 and 19.6 m. These require 4.2, 5.3, 6.6 and 10.6 m/s²; whole values are tried.
    """
    gaps = {40.0: 5.0, 30.0: 6.0, 22.0: 7.0, 10.0: INSUFFICIENT_MPS2}
    for gap, braking in gaps.items():
        view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 50.0 + gap + LENGTH_M, 20.0))
        stop = Manoeuvre("hard-stop", 1, view.ways[1], SpeedProfile(then_mps2=-8.0))
        assert needed(view, stop) == [braking], gap


def test_a_leader_that_drives_on_requires_no_braking(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 25.0))
    assert needed(view, Manoeuvre("hard-stop", 1, view.ways[1])) == [0.0]


def test_a_stop_that_is_perceived_later_requires_harder_braking(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 90.0, 20.0))
    stop = Manoeuvre("hard-stop", 1, view.ways[1], SpeedProfile(then_mps2=-6.0))
    assert needed(view, stop, perceived_s=1.0)[0] > needed(view, stop)[0]


def change(view: SituationView) -> Manoeuvre:
    proposals = [m for m in KINDS["cut-in"](view, 1) if m.goal is not None]
    assert proposals
    return replace(proposals[0], profile=SpeedProfile())


def is_lawful(view: SituationView, manoeuvre: Manoeuvre, begun: bool = False) -> bool:
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    return bool(lawful_mask(view, [manoeuvre], futures, begun=begun)[0])


@pytest.mark.parametrize(("spare", "allowed"), [(-0.5, False), (0.5, True)])
def test_a_lane_change_needs_the_safe_gap(motorway: RoadMap, spare: float, allowed: bool) -> None:
    """Both drive at 20 m/s. The follower counts as 0.5 m/s faster, and the gap as a tenth and 1 m larger."""
    gap = 1.1 * safe_gap_m(20.5, 20.0) + 1.0 + spare
    view = view_of(motorway, target=(0, 50.0, 20.0), other=(1, 50.0 + LENGTH_M + gap, 20.0))
    assert is_lawful(view, change(view)) is allowed


def test_a_manoeuvre_must_not_collide_with_others(motorway: RoadMap) -> None:
    cars = {"target": (0, 50.0, 20.0), "other": (1, 90.0, 20.0)}
    free = view_of(motorway, **cars)
    assert is_lawful(free, change(free))
    blocked = view_of(motorway, **cars, beside=(0, 92.0, 20.0))
    assert not is_lawful(blocked, change(blocked))


def test_a_manoeuvre_keeps_to_the_limit(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), other=(1, 90.0, 20.0))
    limit = view.ways[1].lane.speed_mps
    assert not is_lawful(
        view, Manoeuvre("cut-in", 1, view.ways[1], SpeedProfile(3.0, 6.0, highest_mps=1.3 * limit))
    )


def test_a_manoeuvre_stops_at_red_lights(networks: object) -> None:
    road = RoadMap.read(f"{networks}/downtown.net.xml")
    link = next(
        x for lane in road.lanes.values() for x in lane.successors if x.tls_id and not lane.is_internal
    )
    lane = road.lanes[link.from_lane]
    place = max(lane.length_m - 25.0, 5.0)
    scene = scene_on({"target": (lane, max(place - 12.0, 1.0), 8.0), "other": (lane, place, 8.0)})
    for letter, allowed in (("r", False), ("G", True)):
        lights = {link.tls_id or "": letter * 60}
        view = SituationView.of(road, replace(scene, signals=lights))
        steady = Manoeuvre("stop-and-go", 1, view.ways[1], SpeedProfile())
        assert is_lawful(view, steady) is allowed


def test_a_stop_may_not_begin_where_it_ends_on_a_junction_but_may_go_on_there(networks: object) -> None:
    """From 8 m/s it stops within 8²/(2·4) = 8 m: 3 m before the end of its lane lies a junction, 20 m before not."""
    road = RoadMap.read(f"{networks}/downtown.net.xml")
    links = (x for lane in road.lanes.values() if lane.length_m > 60.0 for x in lane.successors)
    straight = (x for x in links if x.direction == "s" and not x.yields and not x.tls_id)
    link = next(x for x in straight if sum(road.lanes[name].length_m for name in x.via) > 10.0)
    lane = road.lanes[link.from_lane]
    for before_m, may_begin in ((20.0, True), (3.0, False)):
        place = lane.length_m - before_m
        view = SituationView.of(
            road, scene_on({"target": (lane, place - 25.0, 8.0), "other": (lane, place, 8.0)})
        )
        stop = Manoeuvre("hard-stop", 1, view.ways[1], SpeedProfile(then_mps2=-4.0))
        assert is_lawful(view, stop) is may_begin
        assert is_lawful(view, stop, begun=True)


def test_the_hardest_manoeuvre_that_braking_avoids_is_chosen(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 85.0, 20.0))
    proposals = [m for kind in KINDS.values() for m in kind(view, 1)]
    best = rank(view, proposals, dict.fromkeys(KINDS, 1.0))[0]
    assert best.manoeuvre.kind == "hard-stop"
    assert 5.0 <= best.needed_mps2 <= 7.0


def test_of_two_vehicles_ahead_only_one_stops(motorway: RoadMap) -> None:
    """9.5 m apart at 20 m/s; with 6 and 7.5 m/s² the rear one would run into the other."""
    cars = {"target": (0, 100.0, 20.0), "near": (0, 128.0, 20.0), "far": (0, 142.0, 20.0)}
    memory = Commitments.start("hard-stop", np.random.default_rng(0))
    _, memory = update_manoeuvres(view_of(motorway, 27.0, **cars), memory, 2, 8.0)
    driven, memory = update_manoeuvres(view_of(motorway, 30.0, **cars), memory, 2, 8.0)
    assert [(m.row, m.is_positioning) for m in driven] == [(1, False)]
    driven, _ = update_manoeuvres(view_of(motorway, 30.5, **cars), memory, 2, 8.0)
    assert [m.row for m in driven] == [1]


def test_a_follower_proposes_no_manoeuvre(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 90.0, 20.0), follower=(0, 50.0, 30.0))
    assert [m for kind in KINDS.values() for m in kind(view, 1)] == []


@pytest.mark.parametrize(
    ("beside_m", "walks_mps", "allowed"), [(2.5, 1.0, False), (2.5, 0.0, True), (12.0, 1.0, True)]
)
def test_a_manoeuvre_does_not_drive_into_people(
    motorway: RoadMap, beside_m: float, walks_mps: float, allowed: bool
) -> None:
    """A leader drives on at 10 m/s. A pedestrian 20 m ahead of it faces along the road."""
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 80.0, 10.0), walker=(0, 100.0, 0.0))
    scene, walker = view.scene, view.scene.history.index["walker"]
    yaw = scene.history.yaw_rad[walker, 0]
    right = np.array((np.sin(yaw), -np.cos(yaw)))
    history = replace(
        scene.history, classes=np.array([0, 0, AgentClass.PEDESTRIAN]), xy_m=scene.history.xy_m.copy()
    )
    back = 0.5 * np.arange(history.steps - 1, -1, -1)
    history.xy_m[walker] += right * (beside_m + walks_mps * back)[:, None]
    history.size_m[walker] = 0.6
    crowd = SituationView.of(motorway, replace(scene, history=history))
    assert crowd.off_lane_rows.tolist() == [walker]
    assert is_lawful(crowd, Manoeuvre("hard-stop", 1, crowd.ways[1])) == allowed


def test_a_cut_out_requires_braking_for_the_standing_vehicle(motorway: RoadMap) -> None:
    """A vehicle stands ahead of the leader, which leaves the lane 2 s before it. The target then has to stop."""
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 65.0, 10.0), broken=(0, 93.0, 0.0))
    proposals = list(KINDS["cut-out"](view, 1))
    assert {m.revealed_row for m in proposals} == {2}
    gap_m = 93.0 - 65.0 - 4.5
    assert [m.delay_s for m in proposals if m.goal is not None][:1] == pytest.approx([gap_m / 10.0 - 2.0])
    best = rank(view, proposals, {"cut-out": 1.0})[0]
    assert best.needed_mps2 >= 2.0
    alone = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 65.0, 10.0))
    assert list(KINDS["cut-out"](alone, 1)) == []


def test_a_leader_keeps_its_lane_until_it_cuts_out(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 65.0, 10.0), broken=(0, 93.0, 0.0))
    late = next(KINDS["cut-out"](view, 1))
    future = futures_of_manoeuvres([late], np.array([10.0]))
    aside = np.abs(late.way.line.project(future.xy_m[0])[1])
    assert (aside[late.delay_s >= CHECK_TIMES_S] < 0.01).all()
    assert aside[-1] > 2.5
