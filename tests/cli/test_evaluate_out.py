"""Where ``evaluate`` cannot write its figures it says so before it judges for minutes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import advdiff_sumo.training.evaluation as evaluation
from advdiff_sumo.cli.evaluate import judge_and_show
from advdiff_sumo.core.errors import FileError


class JudgedError(Exception):
    """The judging began."""


@pytest.fixture
def judge(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the verb's end, in which judging raises :class:`JudgedError`."""

    def begin(*_: object) -> None:
        raise JudgedError

    monkeypatch.setattr(evaluation, "evaluate_bundle", begin)
    return lambda out: judge_and_show(None, None, None, None, out)


def test_a_place_that_is_none_is_refused_first(judge: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match=r"cannot be written \(Not a directory\); choose another --out"):
        judge(tmp_path / "file" / "figures.json")
    with pytest.raises(FileError, match=r"cannot be written \(No such file or directory\); choose another"):
        judge(tmp_path / "none" / "figures.json")
    with pytest.raises(FileError, match="is a folder; name a file in --out"):
        judge(tmp_path)


def test_a_file_in_a_folder_is_judged_for(judge: Any, tmp_path: Path) -> None:
    with pytest.raises(JudgedError):
        judge(tmp_path / "figures.json")
