"""``advdiff-sumo report``, ``figure`` and ``video``: their files, and errors in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.e2e.commands import Outcome
from tests.report.conftest import drive, episode, struck, write_folder


@pytest.fixture
def finished(workplace: Path) -> Path:
    """Return a run with one episode without a collision and one with a collision."""
    states = drive(0, "ego", 100.0, 100.0, 10.0, target=True) + drive(0, "bv", 100.0, 110.0, 10.0)
    states += drive(1, "ego", 85.0, 101.0, 10.0, target=True) + drive(1, "bv", 105.0, 101.0, 5.0)
    return write_folder(workplace / "run", [episode(0, min_clearance_m=8.0), struck(1)], states)


@pytest.mark.parametrize(
    ("words", "begins"),
    [
        (("figure", "run", "a.svg"), b"<?xml"),
        (("figure", "run", "a.png", "--episode", "0", "--panels", "2"), b"\x89PNG"),
        (("figure", "run", "a.png", "--panels", "0"), b"\x89PNG"),
        (("video", "run", "a.gif", "--episode", "1", "--start", "2"), b"GIF89a"),
    ],
)
def test_the_requested_file_is_written(
    here: Callable[..., Outcome], finished: Path, workplace: Path, words: tuple[str, ...], begins: bytes
) -> None:
    outcome = here(*words)
    assert (outcome.code, outcome.out.strip(), outcome.err) == (0, words[2], "")
    assert (workplace / words[2]).read_bytes().startswith(begins)


def test_report_is_written_again(here: Callable[..., Outcome], finished: Path) -> None:
    outcome = here("report", "run")
    assert (outcome.code, outcome.out.strip()) == (0, str(Path("run") / "report.html"))
    assert (finished / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("figure", "run", "a.pdf"), "a.pdf: is neither .svg nor .png; choose one of these endings"),
        (("video", "run", "a.avi"), "a.avi: is neither .mp4 nor .gif; choose one of these endings"),
        (
            ("figure", "gone", "a.svg"),
            "gone/run.toml: is missing; give the folder of a finished run or sweep",
        ),
        (("report", "gone"), "gone/run.toml: is missing; give the folder of a finished run or sweep"),
        (("video", "run", "a.gif", "--episode", "7"), "run: has no episode 7; it has 0 to 1"),
        (("figure", "run", "a.svg", "--start", "9"), "9 to 3 s is no stretch of the episode"),
        (("figure", "run", "a.svg", "--panels", "9"), "panels=9: give a number from 1 to 8"),
        (("figure", "run", "a.svg", "--panels", "0", "--end", "2"), "--start and --end go with --panels"),
        (("video", "run", "no/a.gif"), "no/a.gif: cannot be written"),
        (("video", "run", "a.gif", "--speed", "0"), "--speed"),
    ],
)
def test_refuses_in_one_sentence(
    refused: Callable[..., str], finished: Path, words: tuple[str, ...], told: str
) -> None:
    assert told in refused(*words)
