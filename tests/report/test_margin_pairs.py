"""The page of a margin: the failing beside the passing neighbour, in one view."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from advdiff_sumo import load
from advdiff_sumo.core.errors import FileError
from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.margin_pairs import margins_of
from advdiff_sumo.report.margin_table import COMMAND, TRIALS, TrialRow, read_trials, trials_text
from advdiff_sumo.report.nets import NetLayers
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
    stop, crossing = margins_of(run, NetLayers(run))
    assert [side.trial.value for side in stop.neighbours] == [2.75, 2.5]
    assert [(side.start_s, side.end_s) for side in stop.neighbours] == [(0.0, 3.0), (0.0, 3.0)]
    failing, passing = (side.svg for side in stop.neighbours)
    assert failing.view_box == passing.view_box
    assert failing.impact is not None
    assert passing.impact is None
    assert crossing.neighbours == ()
    assert crossing.passes is None


def test_the_gap_is_that_to_who_attacks_in_both(folder: Path) -> None:
    """Somebody beside is nearer than who attacks, who begins 30 m ahead: 25 m between two cars of 5 m."""
    path = folder / "states.parquet"
    beside = [*drive(0, "beside", 80.0, 104.0, 10.0), *drive(1, "beside", 80.0, 104.0, 8.0, steps=41)]
    table = pq.read_table(path)
    pq.write_table(pa.concat_tables([table, pa.Table.from_pylist(beside, schema=table.schema)]), path)
    rows = pq.read_table(folder / "episodes.parquet")
    at = rows.schema.get_field_index("min_clearance_partner")
    nearest = pa.array(["bv", "beside"], rows.schema.field(at).type)
    pq.write_table(rows.set_column(at, rows.schema.field(at), nearest), folder / "episodes.parquet")
    run = FinishedRun.read(folder)
    stop, _ = margins_of(run, NetLayers(run))
    for side, least, speed in zip(stop.neighbours, (1.0, 13.0), (2.0, 4.0), strict=True):
        driven, gap = side.charts
        assert f"Speed of the attacker: least {speed:.1f} m/s" in driven.summary
        assert gap.title == "Gap to the attacker (m)"
        assert f"least {least:.1f} m at 3.0 s, greatest 25.0 m at 0.0 s" in gap.summary


def test_where_nobody_attacked_it_is_the_gap_to_the_nearest(folder: Path) -> None:
    by_chance = [replace(row, encounter=not row.valid_failure and row.encounter) for row in ROWS]
    (folder / TRIALS).write_text(trials_text(by_chance), encoding="utf-8")
    run = FinishedRun.read(folder)
    stop, _ = margins_of(run, NetLayers(run))
    assert [side.charts[1].title for side in stop.neighbours] == ["Gap to the nearest (m)"] * 2


def test_the_page_says_where_the_target_fails(folder: Path) -> None:
    html = write_report(folder).read_text(encoding="utf-8")
    words = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    assert "hard-stop: fails at 2.75 m/s², copes at 2.5 m/s² (braking)" in words
    assert "nobody was in a position for it" in words
    assert "1 ✓ , 2.5 ✓ , 2.75 ✕ , 8.5 ✕" in words


def test_the_page_is_that_of_a_margin_and_knows_no_rates(folder: Path) -> None:
    command = "advdiff-sumo margin --target av:Mine --net city --attack hard-stop --out ../again"
    (folder / COMMAND).write_text(f"{command}\n", encoding="utf-8")
    settings = folder / "run.toml"
    settings.write_text(settings.read_text(encoding="utf-8").replace('"IDM"', '"av:Mine"'), encoding="utf-8")
    html = write_report(folder).read_text(encoding="utf-8")
    assert "<h1>Margin of av:Mine on lost, seed 3</h1>" in html
    told = "To repeat it, in this folder with the folder of av.py on PYTHONPATH:"
    assert f"<span>{told}</span> <code>{command}</code>" in html
    assert "advdiff-sumo sweep" not in html
    for part in ("rates", "matrix", "archive"):
        assert f'id="{part}"' not in html
    assert "95 % interval" not in html
    (folder / COMMAND).unlink()
    assert "To repeat it" not in write_report(folder).read_text(encoding="utf-8")


def test_the_player_of_one_of_them_has_no_neighbours(folder: Path) -> None:
    html = load(folder).worst().player().page
    assert "<h1>Margin of IDM on lost, seed 3</h1>" in html
    assert 'class="views pair"' not in html
    assert 'id="row-0"' in html
    assert 'id="row-1"' not in html


def test_other_folders_have_no_margin(two_episodes: Path) -> None:
    assert 'id="margins"' not in write_report(two_episodes).read_text(encoding="utf-8")


def test_damaged_trials_are_refused(folder: Path) -> None:
    (folder / TRIALS).write_text("attack,by\nhard-stop,braking\n", encoding="utf-8")
    with pytest.raises(FileError, match=r"margin\.csv: is damaged .*repeat advdiff-sumo margin"):
        write_report(folder)
