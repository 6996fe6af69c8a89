"""Tables of the results of a sweep."""

from __future__ import annotations

import pytest
from rich.console import Console

from advdiff_sumo.cli.sweep_results import _print_findings, print_worst
from advdiff_sumo.sweep.findings import findings


def test_targets_with_different_options_are_distinguished(capsys: pytest.CaptureFixture[str]) -> None:
    row = {"key": "a1", "target": "my:P", "background": "replay", "background_options": '{"max_gap_s":2.0}'}
    row |= {"end": "horizon", "target_collision": False, "min_ttc_s": None, "min_clearance_m": 2.0}
    options = ('{"defects":["late:strong"]}', "{}")
    print_worst(Console(width=200, markup=False), [{**row, "target_options": given} for given in options])
    cells = [
        [cell.strip() for cell in line.split("│")[2:4]]
        for line in capsys.readouterr().out.splitlines()
        if "a1" in line
    ]
    assert cells == [["my:P defects:[late:strong]", "replay max_gap_s:2.0"], ["my:P", "replay max_gap_s:2.0"]]


def test_configurations_of_one_planner_are_different_targets(capsys: pytest.CaptureFixture[str]) -> None:
    places = {f"{what}_{way}_m": 1.0 for what in ("impact", "approach") for way in ("ahead", "left")}
    row = {
        **places,
        "target": "my:P",
        "target_speed_mps": 8.0,
        "partner_speed_mps": 5.0,
        "approach_yaw_rad": 0.0,
    }
    row |= {
        "collision_type": "cut_in",
        "junction_type": "road",
        "at_fault": "target",
        "target_collision": True,
    }
    row |= {"valid_failure": True, "end": "collision", "impact_speed_mps": 3.0, "closing_speed_mps": 3.0}
    options = ("{}", '{"defects":["late:strong"]}', "{}")
    rows = [{**row, "target_options": given, "episode": k, "key": f"a{k}"} for k, given in enumerate(options)]
    _print_findings(Console(width=200, markup=False), findings(rows))
    assert "my:P defects:[late:strong] 1, my:P 2" in capsys.readouterr().out


def test_the_partner_of_a_critical_near_miss_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    row = {"key": "a1", "target": "my:P", "background": "replay", "end": "horizon", "target_collision": False}
    row |= {"target_options": "{}", "background_options": "{}", "min_ttc_s": 1.0, "min_clearance_m": 2.0}
    row |= {"critical": True, "resolved_by": "other"}
    print_worst(Console(width=200, markup=False), [{**row, "near_miss_partner": "v80"}, row])
    out = capsys.readouterr().out
    assert "critical near miss with v80, resolved by: other" in out
    assert "critical near miss, resolved by: other" in out  # of a folder of an earlier version


def test_rules_that_the_target_broke_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    row = {"key": "a1", "target": "my:P", "background": "replay", "end": "horizon", "target_collision": False}
    row |= {"target_options": "{}", "background_options": "{}", "min_ttc_s": 1.0, "min_clearance_m": 2.0}
    print_worst(Console(width=200, markup=False), [{**row, "offences": "red_light, speeding"}, row])
    out = capsys.readouterr().out
    assert "broke a rule: red light, speeding" in out
    assert "│ horizon " in out  # of one that broke none
