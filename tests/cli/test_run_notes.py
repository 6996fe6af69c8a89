"""Notes on what has changed since a folder was begun."""

from __future__ import annotations

import pytest

from advdiff_sumo.cli.run import tell_changed_code


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ((), ""),
        (("mine:A",), "note: the file of mine:A has changed since this was begun"),
        (("mine:A", "mine:B"), "note: the files of mine:A, mine:B have changed since this was begun"),
    ],
)
def test_one_note_names_all_planners_whose_file_has_changed(
    changed: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {"mine:A": "1", "mine:B": "1", "advdiff-sumo": "0.2"}
    tell_changed_code(before | dict.fromkeys(changed, "2"), before)
    said = " ".join(capsys.readouterr().err.split())
    assert said.startswith(words)
    assert said.count("note:") == len(changed[:1])
