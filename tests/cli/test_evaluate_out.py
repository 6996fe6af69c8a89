"""``evaluate`` checks that it can write its figures before it judges for minutes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

import advdiff_sumo.training.evaluation as evaluation
from advdiff_sumo.cli.evaluate import judge_and_show
from advdiff_sumo.core.errors import FileError


class JudgedError(Exception):
    """Judging has begun."""


@pytest.fixture
def judge(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the last part of the verb as a function of *out*; judging raises :class:`JudgedError`."""

    def begin(*_: object) -> None:
        raise JudgedError

    monkeypatch.setattr(evaluation, "evaluate_bundle", begin)
    return lambda out: judge_and_show(None, None, None, None, out)


def test_a_path_that_cannot_be_written_is_refused_first(judge: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match=r"cannot be written \(Not a directory\); choose another --out"):
        judge(tmp_path / "file" / "figures.json")
    with pytest.raises(FileError, match=r"cannot be written \(No such file or directory\); choose another"):
        judge(tmp_path / "none" / "figures.json")
    with pytest.raises(FileError, match="is a folder; name a file in --out"):
        judge(tmp_path)


def test_a_read_only_folder_is_refused_first(
    judge: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: not (path == tmp_path and mode == os.W_OK))
    with pytest.raises(
        FileError, match=r"cannot be written \(its folder is read-only\); choose another --out"
    ):
        judge(tmp_path / "figures.json")


def test_judging_begins_if_the_file_can_be_written(judge: Any, tmp_path: Path) -> None:
    with pytest.raises(JudgedError):
        judge(tmp_path / "figures.json")
