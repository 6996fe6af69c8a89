"""``compare`` and ``compare --fail-if`` where episodes are missing, or none finished on both sides."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

import pytest
import typer

from advdiff_sumo.cli.compare import compare
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.experiments.folder_rows import FolderRows
from advdiff_sumo.sweep.job_plan import SweepPlan

_RELEASE, _TODAY = Path("release"), Path("today")
_SENTENCE = "release and today: no seed scene was finished in both"
_GATE = "valid_failure_rate_only_b > 0"
_VALUES = ("min_ttc_s", "min_pet_s", "min_clearance_m", "max_drac_mps2", "brake_max_mps2", "route_progress_m")
_ROW = {
    "scene_key": "s0",
    "episode": 0,
    "target": "my:P",
    "target_options": "{}",
    "background": "sumo",
    "background_options": "{}",
    "target_collision": False,
    "at_fault": None,
    "route_completed": False,
    **dict.fromkeys(_VALUES),
    "end": "horizon",
}


def _folders(monkeypatch: pytest.MonkeyPatch, today: list[dict[str, Any]], missing: int = 0) -> None:
    """Put the sweep *today*, which lacks *missing* episodes, beside a release whose episode finished."""
    found = {_RELEASE: ([_ROW], 0), _TODAY: (today, missing)}
    monkeypatch.setattr(
        "advdiff_sumo.experiments.folder_rows.rows_of_folder",
        lambda folder: FolderRows(folder, cast(SweepPlan, None), found[folder][0], [], found[folder][1]),
    )


def test_a_gate_is_shut_where_nothing_finished(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _folders(monkeypatch, [{**_ROW, "end": "failed"}])
    with pytest.raises(typer.Exit) as end:
        compare(_RELEASE, _TODAY, fail_if=_GATE)
    assert end.value.exit_code == 1
    assert capsys.readouterr() == ("", f"{_SENTENCE}: --fail-if {_GATE} cannot be tested\n")


def test_with_json_the_reason_is_an_object(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _folders(monkeypatch, [{**_ROW, "end": "failed"}])
    with pytest.raises(typer.Exit):
        compare(_RELEASE, _TODAY, fail_if=_GATE, as_json=True)
    output = capsys.readouterr()
    assert f"{json.loads(output.out)['error']}\n" == output.err
    assert _SENTENCE in output.err


def test_without_a_gate_it_is_unusable_input(monkeypatch: pytest.MonkeyPatch) -> None:
    _folders(monkeypatch, [{**_ROW, "end": "failed"}])
    with pytest.raises(ConfigError, match=f"^{_SENTENCE}$"):
        compare(_RELEASE, _TODAY)


@pytest.mark.parametrize(
    ("missing", "why"),
    [
        (3, "3 episodes have not been run; advdiff-sumo sweep --resume today runs them"),
        (0, "its failures say why"),
    ],
)
def test_a_folder_without_results_says_why(monkeypatch: pytest.MonkeyPatch, missing: int, why: str) -> None:
    _folders(monkeypatch, [], missing)
    with pytest.raises(ConfigError, match=f"^today: has no episode with results; {why}$"):
        compare(_RELEASE, _TODAY)


def test_an_unfinished_sweep_is_told_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _folders(monkeypatch, [_ROW], missing=1)
    compare(_RELEASE, _TODAY, fail_if="collision_rate_only_b > 0 or unpaired > 0")
    note = "note: today: 1 episode has not been run; advdiff-sumo sweep --resume today runs it\n"
    assert capsys.readouterr().err == note
