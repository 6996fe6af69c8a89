"""``compare --fail-if`` where no episode finished on both sides."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
import typer

from advdiff_sumo.cli.compare import compare
from advdiff_sumo.core.errors import ConfigError

_RELEASE, _TODAY = Path("release"), Path("today")
_SENTENCE = "release and today: no seed scene was finished in both"


@pytest.fixture
def all_of_today_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    row = {"scene_key": "s0", "episode": 0, "target": "my:P", "target_options": "{}", "background": "sumo"}
    row |= {"background_options": "{}", "target_collision": False}
    ends = {_RELEASE: "horizon", _TODAY: "failed"}
    monkeypatch.setattr(
        "advdiff_sumo.experiments.folder_rows.rows_of_folder",
        lambda folder: SimpleNamespace(episodes=[{**row, "end": ends[folder]}], of_run=True),
    )


@pytest.mark.usefixtures("all_of_today_failed")
def test_a_gate_is_shut_where_nothing_finished(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as end:
        compare(_RELEASE, _TODAY, fail_if="valid_failure_rate_only_b > 0")
    assert end.value.exit_code == 1
    said = f"{_SENTENCE}: --fail-if valid_failure_rate_only_b > 0 cannot be tested\n"
    assert capsys.readouterr() == ("", said)


@pytest.mark.usefixtures("all_of_today_failed")
def test_without_a_gate_it_is_unusable_input() -> None:
    with pytest.raises(ConfigError, match=f"^{_SENTENCE}$"):
        compare(_RELEASE, _TODAY)
