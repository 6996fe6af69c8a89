"""What a run came to, while it goes on and once it has ended."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import parse

import pytest
import typer

from advdiff_sumo.cli.sweep_results import CONDITION_MET, conclude, condition_of
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import FileError
from advdiff_sumo.experiments.folder_rows import FolderRows, rows_of_folder
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sweep.run_engine import run_settings
from advdiff_sumo.sweep.run_folder import RunFolder
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.tasks import Failed
from tests.sim import nets

DIED = StoredEpisode({}, Failed("worker_died", "the worker was ended by SIGKILL"))


def run_of(place: Path, episodes: int, failed: int) -> RunFolder:
    """Return the folder of a run that goes on: of *episodes* the first *failed* came to nothing, without a row."""
    net = nets.crossing(place)
    settings = run_settings(Run.prepare(RunOptions(net=str(net), episodes=episodes)))
    folder = RunFolder.create(place / "run", settings, resume=False)
    for number in range(failed):
        folder.add(number, DIED)
    return folder


def gate(rows: FolderRows, text: str, junit: Path | None = None) -> int:
    """Return the exit code of ``results --fail-if``."""
    try:
        conclude(terminal(), rows, condition_of(text), junit)
    except typer.Exit as left:
        return left.exit_code
    return 0


def test_a_run_that_failed_without_a_row_counts_as_one_that_failed(tmp_path: Path) -> None:
    run_of(tmp_path, 2, 2).consolidate(finished=True)
    rows = rows_of_folder(tmp_path / "run")
    assert rows.episodes == []
    assert [(row["episode"], row["kind"]) for row in rows.failures] == [
        (0, "worker_died"),
        (1, "worker_died"),
    ]
    assert rows.missing == 0
    assert gate(rows, "valid_failures > 0 or failures > 0", tmp_path / "j.xml") == CONDITION_MET
    assert parse(tmp_path / "j.xml").getroot().get("errors") == "2"  # noqa: S314 - our own file
    assert gate(rows, "failures > 2") == 0


@pytest.mark.parametrize(("finished", "missing"), [(False, 2), (True, 0)])
def test_a_run_that_has_ended_lacks_nothing(tmp_path: Path, *, finished: bool, missing: int) -> None:
    """Of three episodes one is there: the others are to come, or the log had one seed scene."""
    run_of(tmp_path, 3, 1).consolidate(finished=finished)
    rows = rows_of_folder(tmp_path / "run")
    assert (len(rows.failures), rows.missing) == (1, missing)
    assert gate(rows, "missing > 0") == (0 if finished else CONDITION_MET)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("failures > 0 or median_min_ttc_s < 1", "failures = 1, median_min_ttc_s is undefined"),
        ("failures > 0 and median_min_ttc_s < 1", "median_min_ttc_s is undefined, no episode has it"),
        (
            "failures > 0 and valid_failures / collisions > 0.5",
            "divides by zero, with collisions = 0, failures = 1, valid_failures = 0",
        ),
    ],
)
def test_a_gate_that_is_shut_by_what_is_undefined_says_so_behind_its_junit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    run_of(tmp_path, 1, 1).consolidate(finished=True)
    assert gate(rows_of_folder(tmp_path / "run"), text, tmp_path / "j.xml") == CONDITION_MET
    (told,) = parse(tmp_path / "j.xml").getroot().iter("failure")  # noqa: S314 - our own file
    assert told.get("message") == f"--fail-if {text}: {words}"
    assert f"{text}: {words}" in capsys.readouterr().out


def test_episodes_that_have_not_been_run_are_an_error_in_junit(tmp_path: Path) -> None:
    run_of(tmp_path, 3, 1).consolidate(finished=False)
    assert (
        gate(rows_of_folder(tmp_path / "run"), "valid_failures > 9 or failures > 9", tmp_path / "j.xml") == 0
    )
    root = parse(tmp_path / "j.xml").getroot()  # noqa: S314 - our own file
    assert (root.get("tests"), root.get("errors")) == ("3", "2")  # who died, what is missing, the gate
    (told,) = (error for error in root.iter("error") if error.get("type") == "missing")
    again = f"advdiff-sumo run --resume --out {tmp_path / 'run'}"
    assert told.get("message") == f"2 episodes have not been run; {again} runs them"


def test_junit_calls_its_cases_alike_wherever_the_net_lies(tmp_path: Path) -> None:
    """A server that builds in another folder each time follows a case by its class."""
    classes = []
    for workspace in ("build-1", "build-2"):
        place = tmp_path / workspace
        place.mkdir()
        run_of(place, 1, 1).consolidate(finished=True)
        gate(rows_of_folder(place / "run"), "failures > 9", place / "j.xml")
        case = next(parse(place / "j.xml").getroot().iter("testcase"))  # noqa: S314 - our own file
        classes.append(case.get("classname"))
    assert classes == ["crossing-priority · IDM · sumo · seed 0"] * 2


@pytest.mark.parametrize(("junit", "why"), [("file/j.xml", ".*exists"), (".", "it is a folder")])
def test_junit_that_cannot_be_written_is_one_sentence_behind_the_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], junit: str, why: str
) -> None:
    run_of(tmp_path, 1, 1).consolidate(finished=True)
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match=rf"cannot be written \({why}\); choose another --junit"):
        gate(rows_of_folder(tmp_path / "run"), "failures > 0", tmp_path / junit)
    assert "--fail-if failures > 0: failures = 1" in capsys.readouterr().out
