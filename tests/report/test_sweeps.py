"""Sweeps: labels, the table by target and background, natural counterparts, histograms."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.histograms import histograms
from advdiff_sumo.report.labels import Labels
from advdiff_sumo.report.matrix import ArchiveLine, ArchiveTable, matrix_of, situations_of
from advdiff_sumo.report.nets import place_name, place_names
from advdiff_sumo.report.page import write_report
from advdiff_sumo.report.reference_episodes import ReferenceEpisodes, thinned_tracks
from advdiff_sumo.report.sample_pictures import Samples, samples_by_background, samples_of
from advdiff_sumo.report.templates import templates
from advdiff_sumo.sweep.spec import SweepSpec


@pytest.fixture
def run(sweep_folder: Path) -> FinishedRun:
    return FinishedRun.read(sweep_folder)


def test_reads_what_tells_the_episodes_apart(run: FinishedRun) -> None:
    assert run.is_sweep
    assert [(row["target"], row["background"]) for row in run.episodes] == [
        ("IDM", "sumo"),
        ("IDM", "replay"),
        ("lane_graph", "sumo"),
        ("lane_graph", "replay"),
    ]


@pytest.mark.parametrize("content", [None, b"PAR1"], ids=["missing", "damaged"])
def test_a_table_of_a_sweep_that_cannot_be_read_names_the_command_that_writes_it_again(
    sweep_folder: Path, tmp_path: Path, content: bytes | None
) -> None:
    folder = shutil.copytree(sweep_folder, tmp_path / "own sweep")
    (folder / "states.parquet").unlink()
    if content is not None:
        (folder / "states.parquet").write_bytes(content)
    with pytest.raises(
        FileError, match=r"states\.parquet: is .*; advdiff-sumo results '.*/own sweep' writes it"
    ):
        FinishedRun.read(folder)


def test_its_settings_are_a_sweep_file(sweep_folder: Path) -> None:
    """The command on the page repeats the sweep from what it left."""
    assert "advdiff-sumo sweep sweep.toml --out ../again" in write_report(sweep_folder).read_text(
        encoding="utf-8"
    )
    spec = SweepSpec.read(sweep_folder / "sweep.toml")
    assert (spec.episodes, spec.horizon_s) == (2, 20.0)


def test_its_commands_name_whose_folder_they_need(sweep_folder: Path, tmp_path: Path) -> None:
    """Each planner of one's own once, for the sweep and for each of its episodes."""
    assert "PYTHONPATH" not in write_report(sweep_folder).read_text(encoding="utf-8")
    folder = shutil.copytree(sweep_folder, tmp_path / "own")
    path = folder / "episodes.parquet"
    table = pq.read_table(path)
    targets = pa.array(["mine.fast:Planner", "mine.fast:Planner", "other:Planner", "IDM"])
    at = table.schema.get_field_index("target")
    pq.write_table(table.set_column(at, table.schema.field(at), targets), path)
    page = write_report(folder).read_text(encoding="utf-8")
    told = "in this folder with the folder of mine/, other.py on PYTHONPATH:"
    assert f"<span>To repeat it, {told}</span> <code>advdiff-sumo sweep" in page
    assert f"To repeat just this episode, {told} <code" in page


def test_a_runs_episodes_get_its_options(two_episodes: Path) -> None:
    row = FinishedRun.read(two_episodes).row(1)
    assert (row["net"], row["target"], row["background"]) == ("/nowhere/lost.net.xml", "IDM", "replay")
    assert row["key"] == ""


def test_matrix_counts_finished_episodes(run: FinishedRun) -> None:
    matrix = matrix_of(run.episodes, Labels(run.episodes))
    assert (matrix.targets, matrix.columns) == (("IDM", "lane_graph"), ("sumo", "replay"))
    cells = [
        [(c.collisions.count, c.collisions.total, c.at_fault.count) for c in row if c] for row in matrix.cells
    ]
    assert cells == [[(0, 1, 0), (1, 1, 1)], [(0, 0, 0), (0, 1, 0)]]
    assert [[c.failed.count for c in row if c] for row in matrix.cells] == [[0, 0], [1, 0]]
    totals = [(c.collisions.count, c.collisions.total, c.failed.count) for c in matrix.totals if c]
    assert totals == [(1, 2, 0), (0, 1, 1)]


def test_a_cell_says_out_of_how_many_each_count_is(sweep_folder: Path, tmp_path: Path) -> None:
    """One of IDM's two episodes is judged, none of lane_graph's, of which one finished."""
    folder = shutil.copytree(sweep_folder, tmp_path / "judged")
    table = pq.read_table(folder / "episodes.parquet")
    for name, values in (
        ("background", ["sumo"] * 4),
        ("valid_failure", [None, True, None, None]),
        ("offences", ["", "speeding", None, None]),
    ):
        field = table.schema.field(name)
        table = table.set_column(table.schema.get_field_index(name), field, pa.array(values, field.type))
    pq.write_table(table, folder / "episodes.parquet")
    page = " ".join(write_report(folder).read_text(encoding="utf-8").split())
    assert "<b>100.0 %</b> [20.7 %, 100.0 %]<br> <span" in page
    counts = "collisions in 1 of 2 (50.0 %); at fault in 1; broke a rule in 1 of 2"
    assert f">1 of 1 judged; {counts}</span>" in page
    assert "<b>–</b> not judged<br> <span" in page
    assert ">collisions in 0 of 1 (0.0 %); at fault in 0</span><br><span" in page
    assert page.count(">1 of 2 failed</span></td>") == 1, "lane_graph's; IDM's cell says nothing of failures"


def test_targets_by_situation(run: FinishedRun) -> None:
    labels = Labels(run.episodes)
    assert situations_of(run.episodes, labels) is None, "written without situations"
    names = ("any", "yellow", "any", "yellow")
    rows = [{**row, "situation": name} for row, name in zip(run.episodes, names, strict=True)]
    matrix = situations_of(rows, labels)
    assert matrix is not None
    assert (matrix.targets, matrix.columns) == (("IDM", "lane_graph"), ("any", "yellow"))
    assert sum(cell.failed.total for cells in matrix.cells for cell in cells if cell) == 4
    assert situations_of([{**row, "situation": "any"} for row in run.episodes], labels) is None


def test_pairs_that_were_not_run_have_no_cell(run: FinishedRun) -> None:
    matrix = matrix_of([run.row(0), run.row(3)], Labels(run.episodes))
    assert matrix.cells[0][1] is None
    assert matrix.cells[1][0] is None
    assert matrix_of([run.row(0)], Labels(run.episodes)).is_single


def _with(row: Any, **options: str) -> dict[str, Any]:
    return {**row, **options}


def test_labels_name_the_options_that_differ(run: FinishedRun) -> None:
    one = _with(run.row(1), background_options='{"attack":"cut_in","k":2}')
    two = _with(run.row(1), background_options='{"attack":["head_on","side"],"k":2}')
    labels = Labels([one, two])
    assert labels.background(one) == "replay (attack cut_in)"
    assert labels.background(two) == "replay (attack head_on+side)"
    assert Labels([one]).background(one) == "replay"
    assert labels.target(one) == "IDM"


def test_labels_always_name_planted_defects(run: FinishedRun) -> None:
    planted = _with(run.row(1), target_options='{"defects":["range:strong","late:1.0"],"tau":1.2}')
    assert Labels([planted]).target(planted) == "IDM (range:strong+late:1.0)"
    sound = _with(run.row(1), target_options='{"tau":1.2}')
    assert Labels([planted, sound]).target(sound) == "IDM"


def test_natural_counterpart_is_the_same_scene_and_target_in_sumos_traffic(run: FinishedRun) -> None:
    naturals = ReferenceEpisodes(run)
    found = naturals.natural_tracks(run.row(1))
    assert found is not None
    assert found.dt_s == pytest.approx(0.5)
    assert found.xy_m[found.index["bv"], 2] == pytest.approx((415.0, 419.0))  # 405 m, and 1 s at 10 m/s
    assert naturals.natural_tracks(run.row(0)) is None  # natural itself
    kept = naturals.natural_tracks(run.row(3))  # its counterpart failed: what the scene was cut from
    assert kept is not None
    assert kept.xy_m[0, -1] == pytest.approx((404.0, 410.0))


def test_a_log_that_is_no_longer_there_is_done_without(
    two_episodes: Path, make_folder: Any, rows: Any
) -> None:
    states = rows.drive(0, "ego", 0.0, 0.0, 10.0, target=True)
    folder = make_folder([rows.episode(0, scene="scene-0061-004")], states, options={"scenes": "/gone"})
    run = FinishedRun.read(folder)
    assert ReferenceEpisodes(run).natural_tracks(run.row(0)) is None
    assert write_report(folder).is_file()


@pytest.mark.data
def test_natural_of_a_log_is_the_log_from_the_seed_scene_on(
    adv_data: Path, make_folder: Any, rows: Any
) -> None:
    states = rows.drive(0, "ego", 0.0, 0.0, 10.0, target=True)
    options = {"scenes": str(adv_data / "nuscenes-mini")}
    folder = make_folder([rows.episode(0, scene="scene-0061-004")], states, options=options)
    run = FinishedRun.read(folder)
    naturals = ReferenceEpisodes(run)
    found, drive = naturals.natural_tracks(run.row(0)), naturals.logged_drive(run.row(0))
    assert found is not None
    assert drive is not None
    now = int(np.argmin(np.abs(found.times_s)))
    assert found.times_s[now] == pytest.approx(0.0)
    assert now == 4
    np.testing.assert_array_equal(found.xy_m, drive.tracks.xy_m)


def test_samples_by_hand(run: FinishedRun) -> None:
    states = run.states(1)
    assert states is not None
    found = samples_of(states.tracks, states.target)
    assert found.speed_mps == pytest.approx(np.full(7, 5.0))  # of the other one, every 0.5 s for 3 s
    assert found.accel_mps2 == pytest.approx(np.zeros(6))
    # bumpers 15 m apart at the start, closing at 5 m/s
    assert found.ttc_s == pytest.approx(3.0 - 0.5 * np.arange(7))


def test_natural_traffic_comes_first(run: FinishedRun) -> None:
    groups = samples_by_background(run, ReferenceEpisodes(run), Labels(run.episodes))
    assert list(groups) == ["sumo", "replay"]
    assert [group.episodes for group in groups.values()] == [1, 2]


def test_histogram_shares_add_up_and_ends_take_what_is_beyond() -> None:
    speeds = Samples(np.array([0.5, 0.5, 99.0, 10.5]), np.zeros(0), np.zeros(0), 1)
    speed, accel, ttc = histograms({"sumo": speeds})
    (outline,) = speed.outlines
    assert outline.summary == "sumo: median 5.5 m/s, 90 % between 0.5 and 85.7 m/s"
    assert outline.path.startswith(
        "M40.0 168.0V34.7H49.7V168.0"
    )  # half, of 60 % up to the top, in the first bin
    assert outline.path.endswith("V101.3H330.0V168.0")  # a quarter in the last one
    assert accel.outlines == ttc.outlines == ()


def test_a_median_of_nothing_has_no_sign() -> None:
    still = Samples(np.zeros(0), np.full(3, -0.01), np.zeros(0), 1)
    (outline,) = histograms({"sumo": still})[1].outlines
    assert outline.summary == "sumo: median 0.0 m/s², 90 % between 0.0 and 0.0 m/s²"


def test_thinned_keeps_half_seconds(run: FinishedRun) -> None:
    states = run.states(0)
    assert states is not None
    assert thinned_tracks(states.tracks).times_s == pytest.approx(0.5 * np.arange(7))


def test_page_of_a_sweep(sweep_folder: Path) -> None:
    html = write_report(sweep_folder).read_text(encoding="utf-8")
    assert "<h1>Sweep planners</h1>" in html
    assert "2 targets in 2 backgrounds on downtown" in html
    assert '<h2 id="matrix">Targets and backgrounds</h2>' in html
    assert "The 2 targets together; the next table has each." in html
    heads = [">Target", ">All", ">sumo", ">replay"]
    places = [html.index(head, html.index('<h2 id="matrix">')) for head in heads]
    assert places == sorted(places)
    assert "collisions in 1 of 2 (50.0 %); at fault in 1" in " ".join(html.split()), "IDM's in both"
    assert write_report(sweep_folder).read_text(encoding="utf-8") == html


@pytest.mark.parametrize(
    ("net", "name"), [("downtown", "downtown"), ("/a/b/c.net.xml", "c"), ("d.net.xml.gz", "d")]
)
def test_places_have_short_names(net: str, name: str) -> None:
    assert place_name(net) == name


def test_places_of_one_name_are_told_apart_by_their_folders() -> None:
    nets = [
        "/x/a/boston.net.xml",
        "/x/b/boston.net.xml",
        "/y/b/boston.net.xml.gz",
        "downtown",
        "/z/town.net.xml",
    ]
    assert list(place_names(nets).values()) == ["a-boston", "x-b-boston", "y-b-boston", "downtown", "town"]
    assert place_names(["downtown", "/my/downtown.net.xml"]) == {
        "downtown": "downtown",
        "/my/downtown.net.xml": "my-downtown",
    }


def test_the_kinds_of_encounters_are_counted_in_words() -> None:
    line = ArchiveLine("crossing", "oncoming", (None,) * 4)
    archives = [ArchiveTable(name, 0, met, (line,) * met) for name, met in (("a", 1), ("b", 2))]
    page = templates().get_template("archive.html").render(archives=archives, manoeuvres=(), played=())
    assert "a: encounters of 1 kind, valid" in page
    assert "b: encounters of 2 kinds, valid" in page
