"""Rates and intervals against values worked out by hand."""

from __future__ import annotations

from typing import Any

from advdiff_sumo.report.rate_blocks import headline
from advdiff_sumo.report.run_summary import summary_figures, summary_lines


def test_headline_counts(rows: Any) -> None:
    episodes = [
        rows.struck(0, attacker_visible=True, valid_failure=True, critical=False, offences="red_light"),
        rows.struck(1, at_fault="other", attacker_visible=False, valid_failure=False, critical=False),
        rows.struck(2, at_fault="unclear"),
        rows.episode(3, route_completed=True, valid_failure=False, critical=True, offences=""),
        rows.episode(4, end="failed", failure_kind="plan_refused"),
    ]
    counts = {line.label: (line.rate.count, line.rate.total) for line in headline(episodes)}
    assert counts == {
        "Valid failures": (1, 3),
        "Critical near misses": (1, 3),
        "Rules broken by the target": (1, 2),
        "Collisions": (3, 4),
        "Collisions, target at fault": (1, 4),
        "Target saw the other": (1, 2),
        "Route completed": (1, 4),
        "Failed episodes": (1, 5),
    }


def test_summary_and_headline_divide_by_the_judged_episodes(rows: Any) -> None:
    """Folders of earlier versions hold episodes without a verdict."""
    episodes = [
        rows.struck(0, valid_failure=True, critical=False, offences="red_light"),
        rows.struck(1),
        rows.episode(2, valid_failure=False, critical=True),
    ]
    lines = dict(summary_lines(episodes, []))
    labels = ("valid failures", "critical near misses", "target breaks a rule", "target collides")
    assert [lines[label].split("  ")[-1] for label in labels] == ["1 of 2", "1 of 2", "1 of 1", "2 of 3"]
    assert [(line.rate.count, line.rate.total) for line in headline(episodes)[:3]] == [(1, 2), (1, 2), (1, 1)]
    assert dict(summary_lines([rows.struck(0)], []))["valid failures"] == "not judged"


def test_times_of_plans_are_in_milliseconds(rows: Any) -> None:
    times = {"target_plan_p50_s": 0.00012, "target_plan_p99_s": 0.0125, "background_plan_p50_s": None}
    lines = dict(summary_lines([rows.episode(0)], [{"episode": 0, "real_time_factor": 9.0, **times}]))
    assert lines["target's plan, median and 99 %"] == "0.12 ms, 12.50 ms"


def test_a_contact_before_a_failure_counts(rows: Any) -> None:
    episodes = [
        rows.struck(0, end="failed", failure_kind="planner_error", valid_failure=True),
        rows.episode(1, valid_failure=False),
        rows.episode(2, end="failed", failure_kind="planner_error"),
    ]
    lines = {line.label: (line.rate.count, line.rate.total, line.of) for line in headline(episodes)}
    assert lines["Valid failures"] == (1, 2, "judged episodes")
    assert lines["Collisions"] == (1, 2, "episodes with an outcome")
    assert lines["Failed episodes"] == (2, 3, "episodes")
    figures = summary_figures(episodes)
    assert [figures[name] for name in ("finished", "valid_failures", "collisions", "at_fault")] == [
        1,
        1,
        1,
        1,
    ]
    assert dict(summary_lines(episodes, []))["failed episodes"].endswith("2 of 3")


def test_what_only_sumos_drivers_see_is_left_out_for_planners(rows: Any) -> None:
    labels = [line.label for line in headline([rows.struck(0, attacker_visible=None)])]
    assert "Target saw the other" not in labels
