"""The page of a margin: the failing beside the passing neighbour, in one view."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.margin_pairs import margins_of
from advdiff_sumo.report.margin_table import TRIALS, TrialRow, read_trials, trials_text
from advdiff_sumo.report.nets import Nets
from advdiff_sumo.report.page import write_report
from tests.report.conftest import drive, episode, struck, write_folder

ROWS = (
    TrialRow("hard-stop", "braking", 1.0, "m/s²", True, False, None),
    TrialRow("hard-stop", "braking", 2.5, "m/s²", True, False, 1),
    TrialRow("hard-stop", "braking", 2.75, "m/s²", True, True, 0),
    TrialRow("hard-stop", "braking", 8.5, "m/s²", True, True, None),
    TrialRow("crossing", "time", 0.0, "s", False, False, None),
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder whose first episode fails, whose second passes, with their trials."""
    states = [
        *drive(0, "ego", 80.0, 100.0, 10.0, target=True),
        *drive(0, "bv", 110.0, 100.0, 2.0),
        *drive(1, "ego", 80.0, 100.0, 8.0, target=True, steps=41),
        *drive(1, "bv", 110.0, 100.0, 4.0, steps=41),
    ]
    rows = [struck(0, valid_failure=True), episode(1, min_clearance_partner="bv", duration_s=4.0)]
    path = write_folder(tmp_path / "margin", rows, states)
    (path / TRIALS).write_text(trials_text(ROWS), encoding="utf-8")
    return path


def test_trials_are_read_as_they_were_written(folder: Path) -> None:
    assert read_trials(folder) == ROWS
    lines = (folder / TRIALS).read_text(encoding="utf-8").splitlines()
    assert lines[0] == "attack,by,value,unit,encounter,valid_failure,episode"
    assert lines[3] == "hard-stop,braking,2.75,m/s²,true,true,0"
    assert lines[5] == "crossing,time,0,s,false,false,"


def test_both_are_shown_over_the_same_seconds_in_the_same_view(folder: Path) -> None:
    run = FinishedRun.read(folder)
    stop, crossing = margins_of(run, Nets(run))
    assert [side.trial.value for side in stop.neighbours] == [2.75, 2.5]
    assert [(side.start_s, side.end_s) for side in stop.neighbours] == [(0.0, 3.0), (0.0, 3.0)]
    failing, passing = (side.svg for side in stop.neighbours)
    assert failing.view_box == passing.view_box
    assert failing.impact is not None
    assert passing.impact is None
    assert crossing.neighbours == ()
    assert crossing.passes is None


def test_the_page_says_where_the_target_fails(folder: Path) -> None:
    html = write_report(folder).read_text(encoding="utf-8")
    words = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    assert "hard-stop: fails at 2.75 m/s², copes at 2.5 m/s² (braking)" in words
    assert "nobody was in a position for it" in words
    assert "1 ✓ , 2.5 ✓ , 2.75 ✕ , 8.5 ✕" in words


def test_other_folders_have_no_margin(two_episodes: Path) -> None:
    assert 'id="margins"' not in write_report(two_episodes).read_text(encoding="utf-8")


def test_damaged_trials_are_refused(folder: Path) -> None:
    (folder / TRIALS).write_text("attack,by\nhard-stop,braking\n", encoding="utf-8")
    with pytest.raises(FileError, match=r"margin\.csv: is damaged .*repeat advdiff-sumo margin"):
        write_report(folder)
