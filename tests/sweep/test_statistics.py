"""Rates, findings, coverage and paired comparison on rows made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from defusedxml.ElementTree import fromstring
from scipy.stats import binom

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.metrics.columns import EPISODE_COLUMNS
from advdiff_sumo.metrics.severity import badge
from advdiff_sumo.sweep.coverage import bands, coverage
from advdiff_sumo.sweep.findings import findings
from advdiff_sumo.sweep.junit import junit_xml
from advdiff_sumo.sweep.paired import COMPARED_NAMES, choose, compare
from advdiff_sumo.sweep.summary_stats import FIGURE_NAMES, Figures, by_kind
from advdiff_sumo.sweep.sweep_columns import SWEEP_TABLES


def row(episode: int, **more: Any) -> dict[str, Any]:
    """Return a row of a finished episode without a collision."""
    empty: dict[str, Any] = dict.fromkeys(SWEEP_TABLES["episodes"])
    empty |= {"episode": episode, "key": f"key{episode}", "scene_key": f"scene{episode}", "net": "downtown"}
    empty |= {"target": "IDM", "target_options": "{}", "background": "replay", "background_options": "{}"}
    empty |= {
        "attack": "replay",
        "root_seed": 0,
        "number": episode,
        "end": "horizon",
        "target_collision": False,
        "valid_failure": False,
        "critical": False,
        "fault_reason": None,
        "verdict": None,
    }
    empty |= {"route_completed": False, "critical_speed_mps": 7.0, "junction_type": "road"}
    assert set(more) <= set(empty)
    return empty | more


def hit(episode: int, ahead: float = 2.4, **more: Any) -> dict[str, Any]:
    """Return a row of a junction collision at 8 m/s, partner from the right."""
    collision: dict[str, Any] = {
        "end": "collision",
        "target_collision": True,
        "collision_type": "junction",
        "collision_time_s": 2.0,
        "at_fault": "other",
        "fault_reason": "It ran a red light.",
        "impact_ahead_m": ahead,
        "impact_left_m": -0.5,
        "approach_ahead_m": 6.0,
        "approach_left_m": -9.0,
        "approach_yaw_rad": np.pi / 2,
        "target_speed_mps": 8.0,
        "partner_speed_mps": 9.0,
        "relative_speed_mps": 12.0,
        "junction_type": "priority",
    }
    return row(episode, **{**collision, **more})


def _passed(k: int) -> dict[str, Any]:
    return row(k, route_completed=k == 2, min_ttc_s=float(k))


def test_rates_with_wilson_intervals() -> None:
    rows = [
        hit(0),
        hit(1, at_fault="target"),
        *(row(k, route_completed=k == 2, min_ttc_s=float(k)) for k in range(2, 10)),
    ]
    rows.append(row(10, end="failed"))
    failures = [{**row(10), "kind": "planner_error"}, {**row(11), "kind": "timeout"}]
    figures = Figures.of(rows, failures, missing=3).named()
    assert set(figures) == FIGURE_NAMES
    assert (figures["episodes"], figures["finished"], figures["missing"]) == (12, 10, 3)
    assert (figures["collision_rate"], figures["fault_rate"], figures["completion_rate"]) == (0.2, 0.1, 0.1)
    assert figures["failure_rate"] == pytest.approx(2 / 12)
    # Wilson (1927) by hand for 2 of 10: centre (2 + z²/2) / (10 + z²), half width z·sqrt(10·.2·.8 + z²/4) / (10 + z²)
    z2 = 1.959963984540054**2
    centre, half = (2 + z2 / 2) / (10 + z2), np.sqrt(z2 * (1.6 + z2 / 4)) / (10 + z2)
    assert figures["collision_rate_low"] == pytest.approx(centre - half)
    assert figures["collision_rate_high"] == pytest.approx(centre + half)
    assert figures["median_min_ttc_s"] == 5.5


def test_a_contact_before_a_failure_counts_everywhere() -> None:
    """Of three episodes, one failed after a valid failure, and one before anything had happened."""
    struck = hit(0, end="failed", valid_failure=True, at_fault="target", attack="replay")
    rows = [struck, row(1), row(2, end="failed")]
    failures = [
        {**row(k), "kind": "planner_error", "message": "m", "log_tail": "", "command": "c"} for k in (0, 2)
    ]
    figures = Figures.of(rows, failures).named()
    assert [figures[name] for name in ("episodes", "finished", "failures")] == [3, 1, 2]
    assert [figures[name] for name in ("valid_failures", "collisions")] == [1, 1]
    assert [figures[name] for name in ("valid_failure_rate", "fault_rate", "failure_rate")] == [
        0.5,
        0.5,
        2 / 3,
    ]
    assert [finding.valid for finding in findings(rows)] == [1]
    assert sum(cell.episodes for cell in coverage(rows, ["replay"], ["priority"]).cells.values()) == 2
    assert compare(rows, rows).pairs == 2
    root = fromstring(junit_xml(rows, failures, {}, None))
    assert [[part.tag for part in case] for case in root.iter("testcase")] == [
        ["failure", "error"],
        [],
        ["error"],
    ]
    assert (root.get("failures"), root.get("errors")) == ("1", "2")
    assert [badge(episode) for episode in rows] == ["valid failure", "no collision", "failed"]


def test_without_a_finished_episode_rates_are_undefined() -> None:
    figures = Figures.of([], [{**row(0), "kind": "timeout"}]).named()
    assert figures["collision_rate"] is None
    assert figures["failure_rate"] == 1.0


def test_figures_of_each_kind() -> None:
    rows = [hit(0), row(1), hit(2, target="ACC")]
    kinds = by_kind(rows, [{**row(3, target="W99"), "kind": "timeout"}], ("target",))
    assert list(kinds) == [("IDM",), ("ACC",), ("W99",)]
    assert [kinds[k].rates["collision_rate"].count for k in kinds] == [1, 1, 0]
    assert kinds["W99",].episodes == 1


def test_near_duplicates_are_one_finding() -> None:
    rng = np.random.default_rng(0)
    same = [hit(k, ahead=2.4 + float(rng.normal(0.0, 0.3))) for k in range(200)]
    behind = [hit(200 + k, ahead=-2.2, approach_yaw_rad=0.0) for k in range(30)]
    other_place = [hit(300 + k, junction_type="traffic_light") for k in range(20)]
    left_road = [
        hit(400, collision_type="off_road", impact_ahead_m=None, approach_yaw_rad=None, at_fault="target")
    ]
    found = findings([*left_road, *behind, row(500), *same, *other_place])
    assert [(len(f.episodes), f.type, f.junction_type) for f in found] == [
        (200, "junction", "priority"),
        (30, "junction", "priority"),
        (20, "junction", "traffic_light"),
        (1, "off_road", "priority"),
    ]
    assert sum(len(f.episodes) for f in found) == 251
    assert found[0].at_fault == {"other": 200}
    assert found[1].worst["episode"] == 200


def test_no_two_collisions_of_a_finding_differ_by_more_than_the_tolerances() -> None:
    chain = [hit(k, ahead=0.5 * k) for k in range(20)]  # neighbours are close, the ends are 9.5 m apart
    found = findings(chain)
    assert len(found) >= 3  # 9.5 m are covered by pieces of at most 3 m
    for finding in found:
        ahead = [0.5 * episode for episode in finding.episodes]
        assert max(ahead) - min(ahead) <= 3.0 + 1e-9


def test_findings_do_not_depend_on_the_order_of_rows() -> None:
    rng = np.random.default_rng(1)
    rows = [
        hit(k, ahead=float(rng.uniform(-3, 3)), target_speed_mps=float(rng.uniform(0, 20))) for k in range(60)
    ]
    assert findings(rows) == findings(rows[::-1])


def test_coverage_counts_what_was_not_tried() -> None:
    assert bands() == ("0-5 m/s", "5-10 m/s", "10-15 m/s", "over 15 m/s")
    rows = [hit(0), row(1, critical_speed_mps=5.0), row(2, critical_speed_mps=4.9), row(3, end="failed")]
    tried = coverage(rows, ["replay", "cut_in", "replay"], ["priority"])
    assert tried.attacks == ("replay", "cut_in")
    assert tried.junctions == ("priority", "road")
    assert len(tried.cells) == 2 * 2 * 4
    assert (
        tried.cells["replay", "priority", "5-10 m/s"].episodes,
        tried.cells["replay", "priority", "5-10 m/s"].collisions,
    ) == (1, 1)
    assert tried.cells["replay", "road", "5-10 m/s"].episodes == 1
    assert tried.cells["replay", "road", "0-5 m/s"].episodes == 1
    assert tried.share == 3 / 16
    assert tried.cells["cut_in", "road", "over 15 m/s"].episodes == 0


def test_pairs_are_tested_by_mcnemar() -> None:
    first = [hit(k) if k < 8 else row(k) for k in range(30)]
    second = [hit(k, target="ACC") if k in {0, 20} else row(k, target="ACC") for k in range(30)]
    found = compare(first, second[::-1])
    change = found.rates["collisions"]
    assert (found.pairs, found.scenes, found.unpaired) == (30, 30, 0)
    assert (change.a.count, change.b.count, change.only_a, change.only_b) == (8, 2, 7, 1)
    assert change.p == pytest.approx(2 * binom.cdf(1, 8, 0.5))  # 18/256
    assert change.low < -6 / 30 < change.high
    assert compare(first, second).rates["collisions"] == change
    assert (change.episodes_a, change.episodes_b) == ((*range(1, 8),), (20,))
    named = found.named()
    assert named.keys() == COMPARED_NAMES
    assert (named["collision_rate_a"], named["collision_rate_only_b"]) == (8 / 30, 1)
    assert named["collision_rate_change"] == pytest.approx(-6 / 30)


def test_without_discordant_pairs_the_interval_is_wilsons() -> None:
    """Wilson's bound for 0 of 30: z² / (30 + z²) = 0.1135."""
    change = compare([hit(k) for k in range(30)], [hit(k, target="ACC") for k in range(30)]).rates[
        "collisions"
    ]
    assert (change.change, change.p) == (0.0, 1.0)
    assert (change.low, change.high) == pytest.approx((-0.1135, 0.1135), abs=1e-4)


def test_values_are_compared_where_both_have_them() -> None:
    first = [row(k, min_ttc_s=3.0) for k in range(10)]
    second = [row(k, target="ACC", min_ttc_s=None if k == 0 else 4.0) for k in range(10)]
    change = compare(first, second).values["min_ttc_s"]
    assert (change.pairs, change.mean, change.low, change.high) == (9, 1.0, 1.0, 1.0)


def test_failed_episodes_make_no_pair() -> None:
    found = compare([row(0), row(1)], [row(0, target="ACC", end="failed"), row(1, target="ACC")])
    assert (found.pairs, found.unpaired) == (1, 2)
    assert (found.unpaired_a, found.unpaired_b) == (1, 1)
    assert (found.named()["failures_a"], found.named()["failures_b"]) == (0, 1)


def test_two_targets_in_both_sweeps_are_paired_each_with_itself() -> None:
    rows = [
        row(2 * k + n, target=t, scene_key=f"s{k}") for k in range(5) for n, t in enumerate(("IDM", "ACC"))
    ]
    found = compare(rows, rows)
    assert (found.pairs, found.scenes) == (10, 5)
    assert found.rates["collisions"].p == 1.0


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ([row(0)], [row(1)], "^the two share no seed scene; compare runs or sweeps of the same nets"),
        ([row(0)], [row(0, target="ACC", end="failed")], "^no seed scene was finished in both$"),
        (
            [row(0), row(1, scene_key="scene0", target="ACC")],
            [row(0)],
            "the first sweep has several episodes for one seed scene; .*: add --a target=IDM or --a target=ACC$",
        ),
        (
            [row(0, target="ACC")],
            [row(0), row(1, scene_key="scene0", target_options='{"tau":2.0}')],
            r"""the second .*: add --b 'target_options={}' or --b 'target_options={"tau":2\.0}'$""",
        ),
    ],
)
def test_what_cannot_be_paired_is_refused(first: list[Any], second: list[Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        compare(first, second)


def test_rows_are_chosen_by_column() -> None:
    rows = [row(0), row(1, target="ACC"), row(2, target="ACC", number=7)]
    assert [r["episode"] for r in choose(rows, ["target=ACC", "number=7"], "--a")] == [2]
    with pytest.raises(ConfigError, match="--a tarket=ACC: no such column; did you mean 'target'"):
        choose(rows, ["tarket=ACC"], "--a")
    with pytest.raises(ConfigError, match=r"--a number: expected COLUMN=VALUE; such as number=0$"):
        choose(rows, ["number"], "--a")
    with pytest.raises(ConfigError, match="none of its episodes is so"):
        choose(rows, ["target=W99"], "--a")
    with pytest.raises(ConfigError, match="--a target=AC: none of its episodes is so; did you mean 'ACC'"):
        choose(rows, ["number=7", "target=AC"], "--a")
    with pytest.raises(ConfigError, match="--a ACC: expected COLUMN=VALUE; did you mean target=ACC"):
        choose(rows, ["ACC"], "--a")


def test_cases_of_a_sweep_that_differ_only_in_the_situation_are_different_suites() -> None:
    rows = [row(0, situation="any"), row(1, situation="yellow"), row(2)]  # the last one of an earlier version
    suites = fromstring(junit_xml(rows, [], {}, None)).findall("testsuite")
    assert [suite.get("tests") for suite in suites] == ["2", "1"]
    anywhere, at_yellow = (str(suite.get("name")) for suite in suites)
    net, others = anywhere.split(" · ", 1)
    assert at_yellow == f"{net} · yellow · {others}"


def test_junit_distinguishes_failures_errors_and_other_collisions() -> None:
    failed = {
        **row(2, end="failed"),
        "kind": "timeout",
        "message": "not\x00finished",
        "log_tail": "<x>",
        "command": "c",
    }
    lost = {**failed, "episode": 3, "number": 3, "target": "ACC"}
    rows = [hit(0, valid_failure=True, verdict="It could have stopped."), row(1), row(2, end="failed")]
    rows += [hit(4), hit(5, valid_failure=None), hit(6, valid_failure=None, at_fault="target")]
    root = fromstring(
        junit_xml(rows, [failed, lost], {0: 1.5}, ("collision_rate > 0", "collision_rate = 0.5"))
    )
    assert {name: root.get(name) for name in ("tests", "failures", "errors")} == {
        "tests": "8",
        "failures": "3",  # a valid failure, one at fault without a verdict, and the condition
        "errors": "2",
    }
    cases = {str(case.get("name")): case for case in root.findall(".//testcase")}
    kinds = {name.split(" (")[0]: [part.tag for part in case] for name, case in cases.items()}
    assert kinds == {
        "scene 0": ["failure"],
        "scene 1": [],
        "scene 2": ["error"],
        "scene 3": ["error"],
        "scene 4": ["system-out"],
        "scene 5": ["system-out"],
        "scene 6": ["failure"],
        "collision_rate > 0": ["failure"],
    }
    cases = list(cases.values())
    assert cases[0][0].get("message") == "junction after 2.0 s, at fault: other. It could have stopped."
    assert cases[0].get("time") == "1.500"
    error = cases[2].find("error")
    assert error is not None
    assert (error.get("message"), error.get("type"), error.text) == ("not?finished", "timeout", "<x>\nc")


def test_valid_failures_are_undefined_without_verdicts() -> None:
    judged = Figures.of([hit(0, valid_failure=True), hit(1), row(2), row(3, critical=True)], []).named()
    assert (judged["valid_failures"], judged["valid_failure_rate"], judged["critical_rate"]) == (
        1,
        0.25,
        0.25,
    )
    older = Figures.of([hit(0, valid_failure=None, critical=None)], []).named()
    assert (older["valid_failure_rate"], older["collision_rate"]) == (None, 1.0)
    found = compare([hit(0, valid_failure=True)], [hit(0, target="ACC")])
    assert found.rates["valid failures"].only_a == 1
    unjudged = compare([hit(0, valid_failure=None)], [hit(0, target="ACC")])
    assert "valid failures" not in unjudged.rates
    assert unjudged.named()["valid_failure_rate_p"] is None


def test_findings_with_valid_failures_come_first() -> None:
    many = [hit(k, ahead=0.0) for k in range(3)]
    found = findings([*many, hit(9, ahead=30.0, valid_failure=True)])
    assert [(f.valid, len(f.episodes)) for f in found] == [(1, 1), (0, 3)]


def test_every_column_of_an_episode_is_in_the_sweeps_table() -> None:
    assert set(EPISODE_COLUMNS) <= set(SWEEP_TABLES["episodes"])
