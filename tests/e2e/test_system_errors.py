"""What the system refuses: exit code 2 and one sentence that names the file and the remedy."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import pytest

from advdiff_sumo.cli.system_errors import system_error
from tests.e2e.commands import Outcome
from tests.e2e.conftest import sentence

Here = Callable[..., Outcome]
LONG = "x" * 300


@pytest.mark.parametrize(
    "words",
    [
        ("verdict", LONG),
        ("run", "--net", LONG),
        ("results", LONG),
        ("figure", LONG, "out.svg"),
    ],
)
def test_a_name_that_is_too_long(refused: Callable[..., str], words: tuple[str, ...]) -> None:
    said = refused(*words)
    assert LONG in said
    assert "choose a shorter name" in said


def test_a_name_in_latin_1(refused: Callable[..., str]) -> None:
    said = refused("run", "--net", "grid.net.xml", "--out", "b\udce9")
    assert said == "error: b\\xe9: its bytes are no text in utf-8; rename it"


def test_a_working_folder_that_was_deleted(
    here: Here, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = workplace / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    said = sentence(here("list", "nets"))
    assert said == "error: the working folder has been deleted; change to another one"


def test_what_is_said_of_the_systems_errors() -> None:
    locked = system_error(PermissionError(errno.EACCES, "Permission denied", "/home/other/run.toml"))
    assert locked is not None
    assert locked.startswith("/home/other/run.toml: Permission denied; ")
    assert "rights" in locked
    full = system_error(OSError(errno.ENOSPC, "No space left on device"))
    assert full is not None
    assert full.startswith("No space left on device; free some space")
    assert system_error(OSError(errno.EISDIR, "Is a directory", "x")) == "x: Is a directory"


def test_an_error_of_a_library_keeps_its_traceback() -> None:
    assert system_error(OSError("Couldn't deserialize thrift")) is None
