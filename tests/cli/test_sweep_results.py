"""Tables of a sweep's results."""

from __future__ import annotations

import pytest
from rich.console import Console

from advdiff_sumo.cli.sweep_results import print_worst


def test_targets_that_differ_by_their_options_are_told_apart(capsys: pytest.CaptureFixture[str]) -> None:
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
