"""The formats that ``advdiff-sumo export`` lists."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from advdiff_sumo.cli.export import export
from advdiff_sumo.core.errors import ConfigError, UnknownNameError


def test_an_unknown_format_lists_all_too(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown format 'foo'; known are: all, commonroad, csv, fcd"):
        export(tmp_path, formats=["foo"])


class Raising:
    """An exporter with an error."""

    def write(self, scene: object, folder: Path) -> tuple[Path, ...]:
        raise ValueError(f"no lanes for {scene}")

    def read(self, path: Path) -> None:
        """Read nothing."""


class Text(Raising):
    """An exporter that returns text."""

    def write(self, scene: object, folder: Path) -> Any:
        return str(folder / "a.txt")


class Demanding(Raising):
    """An exporter that nobody can make without an argument."""

    def __init__(self, licence: str) -> None:
        self.licence = licence


@pytest.fixture
def run_of_one_episode(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr("advdiff_sumo.experiments.folder_rows.put_together", lambda _: None)
    monkeypatch.setattr("advdiff_sumo.cli.export.scene_of", lambda *_: "first-0000")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        (
            "Raising",
            r"raised ValueError: no lanes for first-0000 \(test_export_formats.py, line \d+, write\); corr",
        ),
        ("Text", r"returned '.*a.txt' from write; it must return a tuple of paths"),
        ("Demanding", r"cannot be made: TypeError: .*'licence'; correct it"),
    ],
)
def test_a_faulty_format_of_ones_own_is_one_sentence(
    run_of_one_episode: Path, name: str, sentence: str
) -> None:
    own = f"{__name__}:{name}"
    with pytest.raises(ConfigError, match=f"^format '{own}' {sentence}"):
        export(run_of_one_episode, formats=[own], episode=0)
