"""In how many episodes nobody could do what was asked for, counted by hand."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from advdiff_sumo.report.attack_words import out_of_position, plan_lines, position_lines
from advdiff_sumo.traffic.scripted.scripted_policy import Kind


def row(attack: str | None, in_position: bool | None) -> dict[str, Any]:
    return {"attack_kind": attack, "in_position": in_position}


def test_episodes_are_counted_by_the_kind_asked_for() -> None:
    cut_ins = [row("cut-in", False), row("cut-in", True), row("cut-in", False)]
    rows = [*cut_ins, row("any", True), row(None, None)]
    assert position_lines(rows) == [("no one was in a position to cut in", "in 2 of 3 episodes")]


@pytest.mark.parametrize(("lacking", "remedy"), [(2, "; scenes for it: scene.situation=oncoming"), (1, "")])
def test_most_scenes_without_an_encounter_are_of_the_wrong_situation(lacking: int, remedy: str) -> None:
    rows = [row("oncoming", k >= lacking) for k in range(3)]
    text = "no one was in a position to cross its way from ahead"
    assert position_lines(rows) == [(text, f"in {lacking} of 3 episodes{remedy}")]


@pytest.mark.parametrize(("situation", "has_remedy"), [("merging", False), ("any", True)])
def test_scenes_of_the_suited_situation_are_not_recommended_again(situation: str, has_remedy: bool) -> None:
    of_run = position_lines([row("close-pass", False)], situation)
    of_sweep = position_lines([{**row("close-pass", False), "situation": situation}])
    assert of_run == of_sweep
    assert ("scene.situation=merging" in of_run[0][1]) is has_remedy


def test_every_kind_has_its_line_and_an_unknown_one_its_name() -> None:
    rows = [row("head-on", False), row("swarm", False), row("any", False)]
    assert [words for words, _ in position_lines(rows)] == [
        "no one was in a position to meet it head-on",
        "no one was in a position to attack as 'swarm'",
        "no one was in a position to attack",
    ]


@pytest.mark.parametrize("kind", get_args(Kind))
def test_every_lawful_kind_has_words(kind: str) -> None:
    assert out_of_position(row(kind, False)) != f"attack as '{kind}'"


def test_nothing_is_said_without_an_attack_or_in_folders_of_earlier_versions() -> None:
    assert position_lines([row(None, None), {"episode": 0}]) == []
    assert out_of_position(row("brake", True)) is None


def test_the_first_plan_that_no_vehicle_can_drive_is_named_with_its_episode_and_time() -> None:
    fault = "step 0 moves farther than its speeds allow (plan of 2.5 s)"
    rows = [
        {"episode": 0, "implausible_plans": 0, "implausible_plan": None},
        {"episode": 1, "implausible_plans": 2, "implausible_plan": fault},
        {
            "episode": 2,
            "implausible_plans": 1,
            "implausible_plan": "step 3 turns faster than 3 rad/s (plan of 0.5 s)",
        },
        {"episode": 3, "implausible_plans": None, "implausible_plan": None},  # driven by SUMO
    ]
    assert plan_lines(rows) == [
        ("plans that no vehicle can drive", f"in 2 of 3 episodes; episode 1: {fault}")
    ]
    assert plan_lines(rows[:1]) == []
    keyed = [{**row, "key": f"{row['episode']:06d}"} for row in rows]
    assert "episode 000001: step 0" in plan_lines(keyed)[0][1]
