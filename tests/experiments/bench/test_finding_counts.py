"""What findings are worth, worked by hand."""

from __future__ import annotations

import csv
import io
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.experiments.bench.cells import BenchCell
from advdiff_sumo.experiments.bench.detection import EpisodeOutcome
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult, Gathered
from advdiff_sumo.experiments.bench.finding_counts import (
    count_findings,
    expected_groups,
    findings_text,
    first_costs,
)
from advdiff_sumo.experiments.bench.traces import UNTRACED


def episode(number: int, valid: bool | None, approach: str = "ahead", broke: str = "") -> dict[str, Any]:
    """Return the row of an episode: a collision that is valid or not, or, with None, none."""
    return {
        "episode": number,
        "end": "horizon" if valid is None else "collision",
        "target_collision": valid is not None,
        "valid_failure": bool(valid),
        "other_breaches": broke,
        "in_position": None,
        "approach": approach,
        "attacker_manoeuvre": "hard-stop" if approach == "ahead" else None,
        "target_manoeuvre": "straight",
        "at_fault": "target" if valid else None,
        "closing_speed_mps": 1.0,
        "critical": False,
        "critical_brake_mps2": None,
        "min_ttc_s": 1.0,
        "min_clearance_m": 1.0,
    }


def test_two_of_four_hold_so_many_groups() -> None:
    """Of the six pairs of four, five hold one of the two alike, and three hold the single one: 5/6 + 3/6."""
    assert expected_groups([2, 1], 4, 2) == pytest.approx(8 / 6)
    assert expected_groups([2, 1], 4, 4) == 2.0
    assert expected_groups([], 4, 2) == 0.0
    assert expected_groups([2], 4, 5) is None


@given(st.lists(st.integers(1, 9), min_size=1, max_size=6), st.integers(0, 50))
def test_more_draws_never_hold_fewer_groups(members: list[int], others: int) -> None:
    total = sum(members) + others
    expected = [expected_groups(members, total, drawn) for drawn in range(1, total + 1)]
    assert expected == sorted(expected)  # type: ignore[type-var] # none of them asks for more than there are
    assert expected[-1] == len(members)


def test_collisions_are_counted_by_what_they_are_worth() -> None:
    rows = [
        {**row, "attack": "any"}
        for row in (
            episode(0, True),
            episode(1, True, "from_left"),
            episode(2, False, "behind", "ran_into, speeding"),
            episode(3, False, "beside_left", "ran_into"),
            episode(4, None),
        )
    ]
    found = count_findings(rows)
    assert (found.episodes, found.collisions, found.valid, found.others_broke) == (5, 4, 2, 2)
    assert found.breaches == {"ran_into": 2, "speeding": 1}
    assert found.cells == 2  # a cell without a valid failure is not filled
    assert found.cells_per_100 is None


def test_each_defect_costs_what_it_takes_alone() -> None:
    """The fifth failure of one comes in the sixth scene, twelve episodes of 2 s; the other never has five."""
    sound = {f"s{k}": EpisodeOutcome(failed=False, cpu_s=2.0) for k in range(8)}
    shown = {f"s{k}": EpisodeOutcome(failed=k != 1, cpu_s=2.0) for k in range(8)}
    hidden = {f"s{k}": EpisodeOutcome(failed=k == 7, cpu_s=2.0) for k in range(8)}
    assert first_costs(sound, {"late": shown, "range": hidden}) == [24.0, math.inf]


def test_a_line_a_target_and_background_and_no_median_where_half_are_never_detected() -> None:
    sound, late = (BenchCell("sumo", "lane_graph", "sumo", defect=name) for name in ("sound", "late"))
    gathered = Gathered(
        {
            sound: [EpisodeResult("s", episode(k, None), UNTRACED, None) for k in range(99)],
            late: [EpisodeResult("s", episode(0, True, "from_left"), UNTRACED, None)],
        }
    )
    text = findings_text(
        gathered, {("sumo", "lane_graph"): [24.0, math.inf]}, {("sumo", "lane_graph"): 0.975}
    )
    (row,) = csv.DictReader(io.StringIO(text))
    assert (row["episodes"], row["valid"], row["cells"], row["cells_per_100"]) == ("100", "1", "1", "1.00")
    assert row["median_first_cpu_s"] == ""
    assert row["auc"] == "0.975"
    (row,) = csv.DictReader(io.StringIO(findings_text(gathered, {("sumo", "lane_graph"): [24.0]}, {})))
    assert (row["median_first_cpu_s"], row["auc"]) == ("24.0", "")
