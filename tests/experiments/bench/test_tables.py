"""Tables as text: LaTeX that compiles, CSV that is the same everywhere, rows that are marked, and back from disk."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import pytest

from advdiff_sumo.cli.terminal import Bars, terminal
from advdiff_sumo.core.errors import FileError
from advdiff_sumo.experiments.bench.bench_config import Folder, Request
from advdiff_sumo.experiments.bench.fewshot import marks_of
from advdiff_sumo.experiments.bench.intervals import ratio
from advdiff_sumo.experiments.bench.print_table import print_table
from advdiff_sumo.experiments.bench.table import Head, RowSamples, Table, gaps_of, lines_of, paper_table
from advdiff_sumo.experiments.bench.table_cache import finished_table, read_table, save
from advdiff_sumo.experiments.bench.write_table import escaped_latex, latex_text

HEADS = (
    Head("collision_rate", "CR", "%", 100.0, 1, "high"),
    Head("veh_rate", "veh. coll.", "%", 100.0, 2, "low"),
    Head("hz", "plans", "Hz", digits=1, measured=True),
)
SCENES = [f"s{k}" for k in range(8)]


def row(key: str, hits: int, *, ours: bool = False, reference: bool = False) -> RowSamples:
    flags = [1.0] * hits + [0.0] * (8 - hits)
    samples = {
        "collision_rate": ratio(SCENES, flags, [1.0] * 8, rate=True),
        "veh_rate": ratio(SCENES, [0.0] * 8, [3.0] * 8, rate=True),
        "hz": ratio(SCENES, [12.0] * 8, [1.0] * 8),
    }
    return RowSamples(key, "lane_graph", f"{key}_title & more", samples, reference, ours)


@pytest.fixture
def table() -> Table:
    rows = [
        row("replay", 8, reference=True),
        row("strive", 3),
        row("advsim", 2),
        row("diffusion", 6, ours=True),
    ]
    lines = lines_of(HEADS, rows, paper_table("adversarial"))
    return Table("adversarial", "A title with 50 % & _", HEADS, lines, gaps_of(HEADS, rows), ("A note.",))


def test_the_best_is_marked_among_those_who_compete(table: Table) -> None:
    best = [line.key for line in table.lines if line.cells["collision_rate"].best]
    assert best == ["diffusion"]


def test_differences_are_to_all_in_the_first_column_and_to_the_best_rival_in_the_others(table: Table) -> None:
    pairs = [(gap.column, gap.rival.split("_")[0]) for gap in table.gaps]
    assert pairs == [
        ("collision_rate", "replay"),
        ("collision_rate", "strive"),
        ("collision_rate", "advsim"),
        ("veh_rate", "strive"),
    ]
    assert table.gaps[1].found.value == pytest.approx(3 / 8)
    assert table.gaps[1].found.p == pytest.approx(0.25)  # three pairs, all one way


def test_the_papers_figures_stand_beside(table: Table) -> None:
    cells = {line.key: line.cells["collision_rate"].paper for line in table.lines}
    assert cells == {"replay": 8.45, "strive": 10.33, "advsim": 18.54, "diffusion": 11.03}
    sink = io.StringIO()
    print_table(terminal(file=sink, width=150, force_terminal=True, color_system="standard"), table)
    assert re.search(r"\x1b\[90mpaper 11\.03", sink.getvalue())
    assert "n 8" in sink.getvalue()


def test_a_note_that_was_said_before_the_table_is_not_said_again(table: Table) -> None:
    sink, noted = io.StringIO(), replace(table, notes=("few scenes", "another"))
    bars = Bars(terminal(file=sink))
    bars.say("few scenes")
    print_table(terminal(file=sink), noted, bars.said)
    assert (sink.getvalue().count("few scenes"), sink.getvalue().count("another")) == (1, 1)


def test_the_papers_tables_are_complete() -> None:
    assert len(paper_table("traffic")) == 4
    assert len(paper_table("adversarial")) == 5
    transfer = paper_table("transfer")
    assert len(transfer) == 12
    assert all(len(figures) == 6 for figures in transfer.values())
    assert transfer["strive/simnet"]["lane_graph:av_rate"] == 9.56


def test_latex_is_balanced(table: Table) -> None:
    text = latex_text(table)
    assert re.findall(r"\\begin\{(\w+\*?)\}", text) == ["table*", "tabular"]
    assert re.findall(r"\\end\{(\w+\*?)\}", text) == ["tabular", "table*"]
    bare = re.sub(r"\\[{}\\]", "", text)
    depth = 0
    for letter in bare:
        depth += (letter == "{") - (letter == "}")
        assert depth >= 0
    assert depth == 0
    spec = re.search(r"\\begin\{tabular\}\{(\w+)\}", text)
    assert spec is not None
    rows = [line for line in text.splitlines() if line.endswith(r" \\")]
    assert len(rows) == 5
    assert all(len(re.split(r"(?<!\\)&", line)) == len(spec[1]) for line in rows)
    assert r"\textcolor{gray}{11.03}" in text
    assert not re.search(r"(?<!\\)[_#]", text.partition("\\toprule")[2])


def test_letters_of_latex_are_escaped() -> None:
    assert escaped_latex("a_b & 5 %") == r"a\_b \& 5 \%"


def test_only_the_file_of_times_holds_times(table: Table, tmp_path: Path) -> None:
    folder = Folder(tmp_path, Request(bench="adversarial"))
    save(folder, table)
    rows = list(csv.DictReader((tmp_path / "table.csv").read_text().splitlines()))
    assert {r["column"] for r in rows} == {"collision_rate", "veh_rate"}
    assert {r["column"] for r in csv.DictReader((tmp_path / "timing.csv").read_text().splitlines())} == {"hz"}
    assert '"hz"' not in (tmp_path / "table.json").read_text()
    ours = next(r for r in rows if r["row"].startswith("diffusion") and r["column"] == "collision_rate")
    assert (float(ours["value"]), ours["n"], ours["paper"]) == (75.0, "8", "11.03")
    assert (tmp_path / "table.png").read_bytes().startswith(b"\x89PNG")


def test_a_finished_folder_gives_its_table_back(table: Table, tmp_path: Path) -> None:
    folder = Folder(tmp_path, Request(bench="adversarial"))
    assert finished_table(folder) is None
    save(folder, table)
    assert finished_table(folder) == table.__class__(**{**vars(table), "heads": HEADS})
    assert finished_table(Folder(tmp_path, Request(bench="adversarial", scenes="61"))) is None
    (tmp_path / "table.json").write_text("{")
    with pytest.raises(FileError, match="run the bench again"):
        read_table(tmp_path)


@pytest.mark.parametrize("bench", ["transfer", "fewshot"])
def test_pictures_of_the_other_benches(bench: str, tmp_path: Path) -> None:
    keys = ("IDM:av_rate", "W99:av_rate") if bench == "transfer" else ("steps_0", "steps_30")
    heads = tuple(Head(key, key, "%", 100.0) for key in keys)
    samples = {key: ratio(SCENES, [1.0] * 4 + [0.0] * 4, [1.0] * 8, rate=True) for key in keys}
    lines = lines_of(heads, [RowSamples("diffusion/lane_graph", "", "ours", samples)], {})
    save(Folder(tmp_path, Request(bench="transfer")), Table(bench, "t", heads, lines))
    assert (tmp_path / "table.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("steps", "marks"), [(90, (30, 60, 90)), (100, (33, 67, 100)), (2, (1, 2)), (1, (1,))]
)
def test_rungs_of_a_warm_up_are_thirds(steps: int, marks: tuple[int, ...]) -> None:
    assert marks_of(steps) == marks
