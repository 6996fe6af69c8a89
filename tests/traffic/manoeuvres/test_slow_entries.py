"""Slow entries into the target's lane: gap, side, lateral motion, and the braking that they require."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.licence import CARELESS, LAWFUL
from advdiff_sumo.traffic.manoeuvres.choice import rank
from advdiff_sumo.traffic.manoeuvres.commitments import Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.continuation import continue_manoeuvres
from advdiff_sumo.traffic.manoeuvres.demanded_braking import demanded_braking
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.required_braking import INSUFFICIENT_MPS2
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import (
    PROPOSALS,
    PULLS_OUT_MPS,
    SETS_OFF_MPS2,
    SLOW_MERGE,
    can_begin_later,
    entry_gap_m,
    pull_out,
    slow_body,
    slow_entry_margin_m,
    slow_merge,
)
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, SpeedProfile
from tests.traffic.manoeuvres.scenes import LENGTH_M, WIDTH_M, long_lane, view_of


def merges(
    road: RoadMap, gap_m: float, target_mps: float, other_mps: float
) -> tuple[SituationView, Manoeuvre]:
    """Return a target on the rightmost lane with a vehicle *gap_m* ahead on the next one, and its lane change."""
    view = view_of(road, target=(0, 50.0, target_mps), other=(1, 50.0 + LENGTH_M + gap_m, other_mps))
    return view, next(m for m in slow_merge(view, 1) if m.goal is not None)


def is_lawful(view: SituationView, manoeuvre: Manoeuvre, licence: object = LAWFUL) -> bool:
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    return bool(lawful_mask(view, [manoeuvre], futures, licence)[0])  # type: ignore[arg-type] - a licence


def demand(view: SituationView, manoeuvre: Manoeuvre) -> float:
    assert view.target is not None
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    return float(demanded_braking(view, view.target, [manoeuvre], futures)[0])


def test_slow_entries_are_no_kinds_of_any_or_of_warm_ups() -> None:
    assert set(PROPOSALS) - set(KINDS) == {"slow-merge", "pull-out"}


def test_the_entry_gap_by_hand() -> None:
    """14 and 3.5 m/s: 0.75 · 14.5 + (14.5² - 3.5²) / 12 = 27.375 m, a tenth and 1 m more, and 0.4 s at 10.5 m/s."""
    assert entry_gap_m(14.0, 3.5, 3.5, 0.4) == pytest.approx(1.1 * 27.375 + 1.0 + 4.2)


@pytest.mark.parametrize(("spare_m", "allowed"), [(-0.5, False), (0.5, True)])
def test_a_slow_merge_leaves_the_lawful_gap(spare_m: float, allowed: bool, motorway: RoadMap) -> None:
    view, change = merges(motorway, 40.0, 14.0, 3.5)
    enters = change.enters_s(view.scene.history.xy_m[1, -1])
    view, change = merges(motorway, entry_gap_m(14.0, 3.5, 3.5, enters) + spare_m, 14.0, 3.5)
    assert is_lawful(view, change) is allowed
    assert is_lawful(view, change, CARELESS)


def test_a_slow_merge_does_not_brake(motorway: RoadMap) -> None:
    _, change = merges(motorway, 40.0, 14.0, 5.0)
    speed = futures_of_manoeuvres([change], np.array([5.0])).speed_mps[0]
    assert (np.diff(speed) >= 0.0).all()
    assert speed[8] == 5.0  # in the lane after 0.8 · 3.2 s; it keeps its speed for the first 2 s
    assert speed[-1] == pytest.approx(5.0 + 0.5 * (6.0 - 0.8 * 3.2), abs=0.1)


@pytest.mark.parametrize(("other_mps", "merge"), [(2.5, False), (3.0, True), (10.0, True), (11.0, False)])
def test_a_merging_vehicle_is_a_fifth_to_three_quarters_as_fast(
    other_mps: float, merge: bool, motorway: RoadMap
) -> None:
    view = view_of(motorway, target=(0, 50.0, 14.0), other=(1, 95.0, other_mps))
    assert any(m.goal is not None for m in slow_merge(view, 1)) is merge


def test_a_vehicle_that_is_too_fast_slows_gently_if_there_is_room(motorway: RoadMap) -> None:
    """Slowing from 8 to 4.2 m/s at 1.5 m/s² takes 2.5 s. In that time a target at 14 m/s comes 20.0 m nearer.

    Then 1.1 (0.75 · 14.5 + (14.5² - 4.2²) / 12) + 1 m and a second at 9.8 m/s are needed, 40.4 m: 64.9 m by centres.
    """
    for ahead_m, slows in ((66.0, True), (62.0, False)):
        view = view_of(motorway, target=(0, 50.0, 14.0), other=(1, 50.0 + ahead_m, 8.0))
        positioning = [m for m in slow_merge(view, 1) if m.is_positioning]
        assert bool(positioning) is slows
        assert all(
            (m.profile.first_mps2, m.profile.lowest_mps) == (-1.5, pytest.approx(4.2)) for m in positioning
        )


@pytest.mark.parametrize(
    ("gap_m", "braking_mps2", "within_six_s"),
    [(60.0, 1.0, 0.0), (45.0, 2.0, 1.0), (20.0, 4.0, 4.0), (9.0, INSUFFICIENT_MPS2, INSUFFICIENT_MPS2)],
)
def test_braking_that_a_slow_leader_requires(
    gap_m: float, braking_mps2: float, within_six_s: float, motorway: RoadMap
) -> None:
    """It is 9.5 m/s slower: 9.5² / 2 (gap - 0.3 - 0.75 · 9.5) is 0.86, 1.20, 3.59 and 28.7, partly after 6 s."""
    v = long_lane(motorway).speed_mps
    view = view_of(motorway, target=(0, 50.0, v), other=(0, 50.0 + LENGTH_M + gap_m, v - 9.5))
    for kind, braking in ((SLOW_MERGE, braking_mps2), ("stop-and-go", within_six_s)):
        assert demand(view, Manoeuvre(kind, 1, view.ways[1], SpeedProfile())) == braking


def test_an_accelerating_target_is_expected_to_go_on_accelerating(motorway: RoadMap) -> None:
    """In 0.75 s it is 6.4 m/s faster, 6.4² / 2 (19.7 - 4.6) = 1.4; at 2 m/s² 7.9 m/s, 7.9² / 2 (19.7 - 5.8) = 2.2."""
    view = view_of(motorway, target=(0, 50.0, 10.0), other=(0, 50.0 + LENGTH_M + 20.0, 4.0))
    merge = Manoeuvre(SLOW_MERGE, 1, view.ways[1], SpeedProfile())
    steady = demand(view, merge)
    view.scene.history.speed_mps[0, -2] = 9.0
    assert (steady, demand(SituationView.of(motorway, view.scene), merge)) == (2.0, 3.0)


def test_lateral_motion_of_a_slow_vehicle_needs_forward_motion(motorway: RoadMap) -> None:
    """A metre sideways takes at least four metres forward: at half the speed it takes twice as long."""
    view, change = merges(motorway, 40.0, 14.0, 3.5)
    assert change.change_time_s(2.2 * CHECK_TIMES_S, CHECK_TIMES_S) == pytest.approx(0.5 * CHECK_TIMES_S)
    assert change.change_time_s(10.0 * CHECK_TIMES_S, CHECK_TIMES_S) == pytest.approx(CHECK_TIMES_S)
    future = futures_of_manoeuvres([change], np.array([3.5]))
    along = float(view.scene.history.yaw_rad[1, -1])
    steepest = np.arctan(1.5 / 4.0) + 0.03  # the lane bends a little
    assert np.abs(wrap_angle(future.yaw_rad[0] - along)).max() < steepest


def test_a_long_front_enters_before_the_careful_driver_perceives_it(motorway: RoadMap) -> None:
    view, change = merges(motorway, 40.0, 14.0, 3.5)
    here = view.scene.history.xy_m[1, -1]
    bus = replace(change, body=replace(slow_body(view, 1), length_m=12.0, width_m=1.8))
    assert bus.enters_s(here) < change.enters_s(here) < change.perceivable_s(here)
    assert bus.perceivable_s(here) == change.perceivable_s(here)


@pytest.mark.parametrize(("target", "other", "is_proposed"), [(1, 0, True), (0, 1, False)])
def test_a_vehicle_pulls_out_from_the_kerb(
    target: int, other: int, is_proposed: bool, motorway: RoadMap
) -> None:
    view = view_of(motorway, target=(target, 50.0, 10.0), other=(other, 95.0, 0.0))
    assert bool(list(pull_out(view, 1))) is is_proposed
    moves = view_of(motorway, target=(target, 50.0, 10.0), other=(other, 95.0, 1.0))
    assert not list(pull_out(moves, 1))


@pytest.mark.parametrize(("agent_class", "heavy"), [(AgentClass.BUS, True), (AgentClass.CAR, False)])
def test_a_vehicle_that_pulls_out_sets_off_as_its_class_can_and_drives_on_slowly(
    agent_class: AgentClass, heavy: bool, motorway: RoadMap
) -> None:
    view = view_of(motorway, target=(1, 50.0, 10.0), other=(0, 100.0, 0.0))
    history = replace(view.scene.history, classes=np.array([AgentClass.CAR, agent_class]))
    view = SituationView.of(motorway, replace(view.scene, history=history))
    proposals = list(pull_out(view, 1))
    speeds = futures_of_manoeuvres(proposals, np.zeros(len(proposals))).speed_mps
    assert speeds[:, 3] == pytest.approx([SETS_OFF_MPS2[heavy]] * 3)  # after a second
    reached = np.array(PULLS_OUT_MPS)
    assert speeds[:, -1] == pytest.approx(reached + 0.3 * (6.0 - reached / SETS_OFF_MPS2[heavy]), abs=0.1)
    for manoeuvre in proposals:
        assert is_lawful(view, manoeuvre)


@pytest.mark.parametrize(("gap_m", "allowed"), [(20.0, False), (30.0, True)])
def test_a_vehicle_that_pulls_out_leaves_the_lawful_gap(
    gap_m: float, allowed: bool, motorway: RoadMap
) -> None:
    """Over the line after 1.6 s (12.8 m at 8 m/s) at 2.9 m/s; then 1.1 (0.75 · 8.5 + (8.5² - 2.9²) / 12) + 1 m."""
    view = view_of(motorway, target=(1, 50.0, 8.0), other=(0, 50.0 + LENGTH_M + gap_m, 0.0))
    manoeuvre = list(pull_out(view, 1))[1]
    enters = manoeuvre.enters_s(view.scene.history.xy_m[1, -1])
    mean, speed = manoeuvre.mean_and_end_speed(enters, 0.0)
    assert (mean, speed) == pytest.approx((0.9 * enters, 1.8 * enters), rel=0.1)
    lawful_m = 1.1 * (0.75 * 8.5 + (8.5**2 - speed**2) / 12.0) + 1.0 + enters * (8.0 - mean)
    assert (gap_m > lawful_m) is allowed
    assert is_lawful(view, manoeuvre) is allowed


def test_a_slow_entry_waits_while_it_can_also_begin_later(motorway: RoadMap) -> None:
    """In half a second a target that is 10.5 m/s faster comes 5.25 m nearer."""
    for spare_m, waits in ((5.5, True), (5.0, False)):
        view, change = merges(motorway, 40.0, 14.0, 3.5)
        enters = change.enters_s(view.scene.history.xy_m[1, -1])
        view, change = merges(motorway, entry_gap_m(14.0, 3.5, 3.5, enters) + spare_m, 14.0, 3.5)
        assert can_begin_later(view, change, 2.0, LAWFUL) is waits
        assert not can_begin_later(view, change, 5.0, LAWFUL)
        assert can_begin_later(view, change, 0.0, LAWFUL) is False


@pytest.mark.parametrize(("spare_m", "waits"), [(13.5, True), (13.0, False)])
def test_with_a_prescribed_gap_it_begins_before_less_than_that_is_left(
    spare_m: float, waits: bool, motorway: RoadMap
) -> None:
    """With 8 m more than the lawful gap prescribed, 5.25 m are lost until the next plan; however little it needs."""
    view, change = merges(motorway, 40.0, 14.0, 3.5)
    enters = change.enters_s(view.scene.history.xy_m[1, -1])
    view, change = merges(motorway, entry_gap_m(14.0, 3.5, 3.5, enters) + spare_m, 14.0, 3.5)
    assert slow_entry_margin_m(view, change, LAWFUL) == pytest.approx(spare_m, abs=0.05)
    for needed_mps2 in (0.0, 2.0):
        assert can_begin_later(view, change, needed_mps2, LAWFUL, spare_gap_m=8.0) is waits


def test_an_entry_that_requires_too_much_braking_is_not_chosen(motorway: RoadMap) -> None:
    weights = {"slow-merge": 1.0}
    view, _ = merges(motorway, 50.0, 14.0, 3.5)
    best = rank(view, list(slow_merge(view, 1)), weights)[0]
    assert best.manoeuvre.goal is not None
    assert 2.0 <= best.needed_mps2 <= 5.0
    near, _ = merges(motorway, 15.0, 14.0, 3.5)
    assert all(
        c.manoeuvre.is_positioning for c in rank(near, list(slow_merge(near, 1)), weights, licence=None)
    )


def continued(road: RoadMap, gap_m: float, aside_m: float) -> list[Manoeuvre]:
    """Return what remains of a slow merge, *gap_m* ahead of a target at 14 m/s, *aside_m* from the lane's middle."""
    place = 80.0 + LENGTH_M + gap_m
    view = view_of(road, time_s=5.0, target=(0, 80.0, 14.0), other=(1, place, 3.5))
    lane = long_lane(road)
    view.scene.history.xy_m[1] += lane.line.at(place, aside_m)[0] - view.scene.history.xy_m[1, -1]
    view = SituationView.of(road, view.scene)
    merging = Commitment(SLOW_MERGE, SpeedProfile(), 4.0, 4.5, is_positioning=False, goal_lane=lane.id)
    memory = Commitments({SLOW_MERGE: 1.0}, active={"other": merging})
    return continue_manoeuvres(view, memory, 8.0, LAWFUL)[0]


@pytest.mark.parametrize(
    ("gap_m", "over_m", "continues"), [(45.0, 0.0, True), (15.0, 0.0, False), (15.0, 0.4, True)]
)
def test_a_merge_that_lost_its_gap_continues_only_once_it_is_over_the_line(
    gap_m: float, over_m: float, continues: bool, motorway: RoadMap
) -> None:
    """27.4 m are needed at the line. From 0.3 m over it no gap is needed any more."""
    aside_m = 0.5 * (long_lane(motorway).width_m + WIDTH_M) - over_m
    assert bool(continued(motorway, gap_m, aside_m)) is continues


@pytest.mark.parametrize(("aside_m", "changes", "left_m"), [(1.0, True, 0.593), (0.1, False, 0.084)])
def test_on_the_target_s_lane_it_moves_on_to_the_middle(
    aside_m: float, changes: bool, left_m: float, motorway: RoadMap
) -> None:
    """Half a second at 3.5 m/s is x = 0.4375 of the 4 m for a metre. Below 0.2 m it is x = 1/4 of 2 s.

    The offset is then (1 - x)² (1 + 2 x) of the first one: 0.593 and 0.844.
    """
    (manoeuvre,) = continued(motorway, 30.0, aside_m)
    assert (manoeuvre.goal is not None) is changes
    future = futures_of_manoeuvres([manoeuvre], np.array([3.5]))
    left = np.abs(long_lane(motorway).line.project(future.xy_m[0])[1])
    assert left[-1] < 0.05
    assert left[1] == pytest.approx(left_m, abs=0.02)
