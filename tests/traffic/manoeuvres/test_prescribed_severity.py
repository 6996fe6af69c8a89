"""Manoeuvres of a prescribed severity, worked by hand on a straight lane and driven on empty roads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.licence import LAWFUL
from advdiff_sumo.traffic.manoeuvres.choice import rank
from advdiff_sumo.traffic.manoeuvres.intensity import Intensity
from advdiff_sumo.traffic.manoeuvres.licence_rules import entry_margin_m
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.prescribed_severity import (
    AFTER_ENTRY_MPS2,
    GAP_TOLERANCE_M,
    arrival_lead_s,
    severity_match,
    target_brakes,
    with_braking,
    with_severity,
)
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import slow_entry_margin_m, slow_merge
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, SpeedProfile
from tests.planners.encounters import Encounter, Scripted, crossing, failed, over, two_lanes
from tests.traffic.manoeuvres.scenes import view_of


def cut_ins(view: SituationView) -> list[Manoeuvre]:
    return list(KINDS["cut-in"](view, 1))


def test_a_prescribed_braking_replaces_only_the_braking_of_an_attack(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), leader=(0, 85.0, 20.0))
    stop, closing = (
        next(m for m in KINDS["hard-stop"](view, 1) if m.is_positioning is is_positioning)
        for is_positioning in (False, True)
    )
    assert with_braking(stop, 2.5).profile.then_mps2 == -2.5
    assert with_braking(stop, None) is stop
    assert with_braking(closing, 2.5) is closing
    go = next(KINDS["stop-and-go"](view, 1))
    assert (with_braking(go, 3.0).profile.first_mps2, with_braking(go, 3.0).profile.then_mps2) == (-3.0, 1.5)
    crosses = Manoeuvre("crossing", 1, view.ways[1], SpeedProfile(-2.0, 1.5))
    assert with_braking(crosses, 8.0) is crosses


def test_a_cut_in_matches_the_prescribed_gap(motorway: RoadMap) -> None:
    """At the target's speed the gap grows with the distance ahead. Up to 3 m more than prescribed are accepted."""
    view = view_of(motorway, target=(0, 50.0, 20.0), beside=(1, 90.0, 20.0))
    change = next(m for m in cut_ins(view) if m.goal is not None)
    spare = entry_margin_m(view, 1, 0, 0.0, LAWFUL)
    further = view_of(motorway, target=(0, 50.0, 20.0), beside=(1, 95.0, 20.0))
    assert entry_margin_m(further, 1, 0, 0.0, LAWFUL) == pytest.approx(spare + 5.0, abs=0.01)
    driven = 20.0 * CHECK_TIMES_S
    for spare_gap_m, match in ((spare - 1.0, 1.0), (spare + 1.0, 0.0), (spare - GAP_TOLERANCE_M - 1.0, 0.0)):
        assert severity_match(view, change, driven, 4.0, Intensity(spare_gap_m=spare_gap_m)) == match
    assert severity_match(view, change, driven, 4.0, Intensity()) is None


def test_a_slow_merge_leaves_at_least_the_prescribed_gap_and_can_be_resolved(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 14.0), crawls=(1, 100.0, 3.5))
    change = next(m for m in slow_merge(view, 1) if m.goal is not None)
    spare_m, driven = slow_entry_margin_m(view, change, LAWFUL), 3.5 * CHECK_TIMES_S
    cases = ((spare_m - 0.1, 5.0, 1.0), (spare_m + 0.1, 2.0, 0.0), (spare_m - 0.1, 6.0, 0.0))
    for spare_gap_m, needed_mps2, match in cases:
        assert severity_match(view, change, driven, needed_mps2, Intensity(spare_gap_m=spare_gap_m)) == match


def test_a_prescribed_gap_changes_the_position_and_fixes_the_braking(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0), beside=(1, 90.0, 20.0))
    far, near = (list(with_severity(view, cut_ins(view), Intensity(spare_gap_m=gap))) for gap in (20.0, 0.0))
    assert [m.profile.then_mps2 for m in far if m.goal is not None] == [-AFTER_ENTRY_MPS2]
    ahead, behind = (
        next(m for m in adapted if m.is_positioning).profile.first_mps2 for adapted in (far, near)
    )
    assert ahead > behind
    assert list(with_severity(view, cut_ins(view), Intensity())) == cut_ins(view)
    wanted = rank(view, far, {"cut-in": 1.0}, intensity=Intensity(spare_gap_m=20.0))
    assert wanted[0].manoeuvre.is_positioning


def test_a_leader_leaves_at_the_prescribed_time_before_the_standing_vehicle(motorway: RoadMap) -> None:
    """It is 23.5 m, 2.35 s, behind the standing vehicle. For 1.5 s it waits 0.85 s; for 2.5 s it is too late."""
    view = view_of(motorway, target=(0, 50.0, 10.0), leader=(0, 65.0, 10.0), broken=(0, 93.0, 0.0))
    leaves = list(KINDS["cut-out"](view, 1))
    late = list(with_severity(view, leaves, Intensity(reveals_s=1.5)))
    assert [m.delay_s for m in late] == pytest.approx([0.85] * len(late))
    assert [m.revealed_row for m in late] == [2] * len(late) != []
    assert severity_match(view, late[0], 10.0 * CHECK_TIMES_S, 4.0, Intensity(reveals_s=1.5)) == 1.0
    assert list(with_severity(view, leaves, Intensity(reveals_s=2.5))) == []
    assert list(with_severity(view, leaves, Intensity(early_s=0.5))) == leaves


def test_a_target_that_brakes(motorway: RoadMap) -> None:
    view = view_of(motorway, target=(0, 50.0, 20.0))
    assert not target_brakes(view)
    view.scene.history.speed_mps[0, -2] = 20.6
    assert target_brakes(view)


SEED = 5
"""Seed of episodes in which the inserted vehicle has a class that shows the defect."""


@pytest.fixture(scope="module")
def encounters(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Encounter]:
    folder = tmp_path_factory.mktemp("nets")
    sign, two, fast = crossing(folder, "priority"), two_lanes(folder, 20.0), two_lanes(folder, 33.0)
    north = ("south_in", "north_out")
    return {
        "crossing": Encounter(sign, Scripted(over(sign, *north), 205.0, 11.0), north, (), 12.0),
        "cut-out": Encounter(fast, Scripted(("WM_0", "ME_0"), 50.0, 28.0), ("WM", "ME"), (), 14.0),
        "cut-in": Encounter(two, Scripted(("WM_0", "ME_0"), 50.0, 18.0), ("WM", "ME"), (), 20.0),
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("attack", "option", "severe", "mild", "defect"),
    [
        ("crossing", "early_s", 0.0, 1.5, "blind-crossing:strong"),
        ("crossing", "early_s", 0.0, 1.0, "late:2.0"),
        ("cut-in", "spare_gap_m", 0.0, 20.0, "late:1.5"),
        ("cut-out", "reveals_s", 1.5, 2.5, "weak-brakes:2.5"),
    ],
)
def test_a_defect_shows_in_a_severe_attack_and_not_in_a_mild_one(
    attack: str, option: str, severe: float, mild: float, defect: str, encounters: dict[str, Encounter]
) -> None:
    def drive(defects: list[str], value: float) -> dict[str, Any]:
        options = {"attack": attack, option: value, "attackers": 1}
        return encounters[attack].drive(defects, "lane_graph", "scripted", options, SEED)

    sound, fails, passes = drive([], severe), drive([defect], severe), drive([defect], mild)
    assert [row["in_position"] for row in (sound, fails, passes)] == [True] * 3
    assert failed(fails)
    assert fails["lawful"]
    assert not sound["target_collision"]
    assert not passes["target_collision"]


def test_how_long_before_the_target_a_vehicle_crosses(encounters: dict[str, Encounter]) -> None:
    """Both drive at 11 m/s on arms of equal length. 11 m further on is 1 s earlier."""
    road = encounters["crossing"].road
    north = over(road, "south_in", "north_out")
    east = over(road, "west_in", "east_out")

    def lead_s(ahead_m: float) -> float | None:
        other = Scripted(east, 262.0 + ahead_m, 11.0)
        seed = Encounter(road, Scripted(north, 262.0, 11.0), ("south_in", "north_out"), (other,)).scene()
        routes = (("south_in", "north_out"), ("west_in", "east_out"))
        scene = Scene(seed.history, 0, np.array([False, True]), routes, {})
        return arrival_lead_s(SituationView.of(road, scene), 1, 11.0 * CHECK_TIMES_S)

    level, earlier = lead_s(0.0), lead_s(11.0)
    assert level is not None
    assert earlier is not None
    assert earlier - level == pytest.approx(1.0, abs=0.05)
