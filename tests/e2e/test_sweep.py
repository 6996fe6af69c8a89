"""``sweep``, ``results``, ``compare`` and ``replay`` as a user types them."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from defusedxml.ElementTree import parse

import advdiff_sumo as ads
from advdiff_sumo.cli.interruption import KEPT
from advdiff_sumo.sweep.sole_writer import sole_writer
from tests.e2e.commands import Outcome, advdiff, begin
from tests.hang_guard import HANG_S

SWEEP = """
episodes = 3
horizon_s = 3.0
scene = { warmup_s = 8.0, scenes_per_warmup = 3, min_neighbours = 1 }

[grid]
nets = ["grid.net.xml"]
targets = ["IDM", "lane_graph"]
backgrounds = ["replay"]
"""
TABLES = (
    *("episodes.parquet", "states.parquet", "collisions.parquet", "failures.parquet"),
    *("plans.parquet", "unattacked.parquet", "signals.parquet"),
)


@pytest.fixture
def sweeps(workplace: Path) -> Path:
    """Return a workplace with a small sweep file."""
    (workplace / "small.toml").write_text(SWEEP)
    return workplace


def test_a_sweep_from_file_to_verdict(
    sweeps: Path, here: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("duckdb", reason="the extra sql is not installed")
    monkeypatch.setenv("COLUMNS", "250")  # room for all columns
    words = ("--executor", "serial", "--out", "done", "--junit", "ci/junit.xml", "--fail-if", "episodes < 6")
    done = here("sweep", "small.toml", *words)
    assert done.code == 0, done.err
    assert "6 episodes; rates in %" in done.out
    totals = [
        cells for line in done.out.splitlines() if (cells := line.replace("│", " ").split())[:1] == ["all"]
    ]
    assert [cells[:4] for cells in totals[:2]] == [["all", "of", name, "3"] for name in ("IDM", "lane_graph")]
    assert totals[2][:2] == ["all", "6"]
    covered = done.out.partition("coverage:")[2].partition("archive:")[0].splitlines()
    rows = [line.replace("│", " ").split() for line in covered if line.startswith("│")]
    assert rows
    assert all("/" in row for row in rows)
    tried = {row[1] for row in rows}
    (untried,) = [
        line.partition(" at: ")[2].split(", ") for line in covered if line.startswith("no episode of")
    ]
    assert untried
    assert tried.isdisjoint(untried)
    assert "look at done/report.html" in done.out
    assert b"<title>done " in (sweeps / "done" / "report.html").read_bytes()
    suites = parse(sweeps / "ci" / "junit.xml").getroot()
    assert suites.get("tests") == "7"

    met = here("results", "done", "--fail-if", "episodes >= 6 or collision_rate > 0.5")
    assert met.code == 1
    narrow = advdiff("results", "done", cwd=sweeps).out  # in 100 columns
    assert "no room for columns: net (grid);" in narrow
    assert "background" in narrow.split("failures ")[0]
    assert "--fail-if episodes >= 6 or collision_rate > 0.5: collision_rate =" in met.out
    query = "select key, target, number from episodes order by episode"
    asked = here("results", "done", "--sql", query, "--format", "json")
    rows = json.loads(asked.out)
    assert [(row["target"], row["number"]) for row in rows] == [
        (target, number) for target in ("IDM", "lane_graph") for number in range(3)
    ]
    assert here("results", "done", "--sql", "select nothing from nowhere").code == 2

    compared = here("compare", "done", "done", "--a", "target=IDM", "--b", "target=lane_graph")
    assert compared.code == 0, compared.err
    assert "3 pairs of episodes from 3 seed scenes" in compared.out

    again = here("replay", rows[4]["key"][:10], "--sweep", "done", "--out", "again")
    assert again.code == 0, again.err
    assert "the same as in the sweep" in again.out
    assert (sweeps / "again" / "report.html").stat().st_size > 0

    _tables_catch_up(sweeps / "done", rows[4]["key"], here)
    refused = here("sweep", "--resume", "done", "--out", "elsewhere")
    assert (refused.code, "leave --out elsewhere out" in refused.err) == (2, True)
    refused = here("sweep", "small.toml", "--executor", "serial", "--out", "done")
    assert (refused.code, len(refused.err.splitlines())) == (2, 1)
    assert "already holds a sweep" in refused.err
    (sweeps / "impossible.toml").write_text('[[cases]]\nnet = "elsewhere.net.xml"\ntarget = "IDM"\n')
    refused = here("sweep", "impossible.toml", "--out", "done")
    assert (refused.code, "already holds a sweep" in refused.err) == (2, True), "it has planned first"
    (sweeps / "other.toml").write_text(SWEEP.replace("3.0", "4.0"))
    refused = here("sweep", "other.toml", "--executor", "serial", "--resume", "done")
    assert (refused.code, len(refused.err.splitlines())) == (2, 1)
    assert refused.err.startswith("error: done: belongs to another sweep: its horizon_s differ")
    _an_older_page_is_told(sweeps / "done", rows[4]["key"], here)


def _an_older_page_is_told(sweep: Path, key: str, here: Callable[..., Outcome]) -> None:
    """Check the note on an older report in a sweep resumed without a report; there is none if nothing is run."""
    (episode,) = sweep.glob(f"episodes/*/{key}")
    episode.unlink()
    goes_on = ("sweep", "--resume", sweep, "--executor", "serial", "--no-report")
    refused = here(*goes_on, "--junit", sweep)
    assert (refused.code, "choose another --junit" in refused.err) == (2, True)
    assert not episode.exists()  # before the first episode
    note = "report.html is that of before; advdiff-sumo report"
    assert note in here(*goes_on).out.replace("\n", " ")
    assert note not in here(*goes_on).out.replace("\n", " ")


def _tables_catch_up(sweep: Path, key: str, here: Callable[..., Outcome]) -> None:
    """Check that results include an episode that finished after the tables were made."""
    (episode,) = sweep.glob(f"episodes/*/{key}")
    kept = episode.read_bytes()
    episode.unlink()
    assert f"1 episode not run yet; advdiff-sumo sweep --resume {sweep} runs it" in here("results", sweep).out
    episode.write_bytes(kept)
    assert here("report", sweep).code == 0
    assert ads.load(sweep).summary().figures["episodes"] == 6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("episodes", "episods"), ("small.toml", "no option 'episods'", "did you mean 'episodes'")),
        (('"lane_graph"', '"lane_grap"'), ("unknown target 'lane_grap'", "did you mean 'lane_graph'")),
        (('["replay"]', "[]"), ("the grid is empty", "grid.backgrounds")),
        (("grid.net.xml", "nowhere.net.xml"), ("nowhere.net.xml", "no such net")),
        (("[grid]", "[grid"), ("not valid TOML",)),
    ],
)
def test_a_wrong_sweep_is_one_sentence_and_leaves_nothing(
    sweeps: Path, refused: Callable[..., str], change: tuple[str, str], words: tuple[str, ...]
) -> None:
    (sweeps / "small.toml").write_text(SWEEP.replace(*change))
    said = refused("sweep", "small.toml", "--out", "out")
    for word in words:
        assert word in said


def test_a_wrong_command_is_one_sentence(sweeps: Path, refused: Callable[..., str]) -> None:
    assert "no sweep file was given" in refused("sweep")
    assert "no figure 'colision_rate'" in refused("sweep", "small.toml", "--fail-if", "colision_rate > 0")
    assert "--ray-address goes with --executor ray" in refused("sweep", "small.toml", "--ray-address", "auto")
    assert "holds no sweep" in refused("sweep", "--resume", "nowhere")
    assert "--resume takes the folder, not --out: advdiff-sumo sweep --resume DIR" in refused(
        *("sweep", "--resume", "--out", "nowhere")
    )
    assert "holds no sweep and no run" in refused("results", "nowhere")
    assert "no sweep in runs has an episode" in refused("replay", "0123456789")


def test_a_target_of_ones_own_in_place_of_those_in_the_file(
    sweeps: Path, here: Callable[..., Outcome], refused: Callable[..., str]
) -> None:
    (sweeps / "mine.py").write_text(
        "from advdiff_sumo.planners.lane_graph import LaneGraphPlanner\n\n\nclass Mine(LaneGraphPlanner):\n    pass\n"
    )
    words = ("sweep", "small.toml", "--target", "mine:Mine", "--target", "IDM")
    more = ("--executor", "serial", "--no-report")
    first = here(*words, "--limit", "4", "--out", "own", *more)
    assert first.code == 0, first.err
    again = here(*words, "--resume", "own", *more)
    assert again.code == 0, again.err
    rows = pq.read_table(sweeps / "own" / "episodes.parquet", columns=["target", "number"]).to_pylist()
    assert [(row["target"], row["number"]) for row in rows] == [
        *((name, number) for name in ("mine:Mine", "IDM") for number in range(3)),
    ]
    assert "that sweep has its targets" in refused("sweep", "--resume", "own", "--target", "IDM")
    assert "give the file, and the --target, that it was begun with" in refused(
        "sweep", "small.toml", "--resume", "own", "--target", "IDM"
    )
    assert "did you mean 'careful'" in refused("sweep", "small.toml", "--target", "carefull")


def test_only_one_process_writes_into_the_folder_of_a_sweep(
    sweeps: Path, here: Callable[..., Outcome], refused: Callable[..., str]
) -> None:
    assert here("sweep", "small.toml", "--executor", "serial", "--limit", "1", "--out", "part").code == 0
    before = {path: path.read_bytes() for path in (sweeps / "part").glob("*.parquet")}
    with sole_writer(sweeps / "part"):
        said = refused("sweep", "--resume", "part", "--executor", "serial")
    assert said.splitlines()[-1] == (
        "error: part: another process is writing into it; wait for its end, or choose a new --out"
    )
    assert {path: path.read_bytes() for path in (sweeps / "part").glob("*.parquet")} == before
    assert here("sweep", "--resume", "part", "--executor", "serial").code == 0
    assert pq.read_metadata(sweeps / "part" / "episodes.parquet").num_rows == 6


@pytest.mark.slow
def test_every_case_of_the_thorough_sweep_has_scenes(tmp_path: Path) -> None:
    shipped = Path(__file__).parents[2] / "scenarios" / "sweeps" / "thorough.toml"
    short = (
        shipped.read_text()
        .replace("episodes = 15", "episodes = 1")
        .replace("horizon_s = 20.0", "horizon_s = 2.0")
    )
    assert short.count("\nepisodes = 1\nhorizon_s = 2.0\n") == 1
    (tmp_path / "short.toml").write_text(short)
    done = advdiff("sweep", "short.toml", "--target", "careful", "--out", "out", "--no-report", cwd=tmp_path)
    assert done.code == 0, done.err
    rows = pq.read_table(tmp_path / "out" / "episodes.parquet", columns=["target", "end"]).to_pylist()
    assert len(rows) == short.count("[[cases]]")
    assert {row["end"] for row in rows} <= {"horizon", "arrived"}


def test_results_by_situation(
    sweeps: Path, here: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "250")  # room for all columns
    text = SWEEP.replace(
        'targets = ["IDM", "lane_graph"]', 'targets = ["IDM"]\nsituations = ["any", "turning"]'
    )
    (sweeps / "situations.toml").write_text(text)
    done = here("sweep", "situations.toml", "--executor", "serial", "--out", "done")
    rows = pq.read_table(sweeps / "done" / "episodes.parquet").to_pylist()
    assert [row["situation"] for row in rows] == ["any"] * 3 + ["turning"] * 3
    assert len({row["scene_key"] for row in rows}) == 6
    lines = [line.split("│") for line in done.out.splitlines() if line.startswith("│ IDM")]
    assert [[cell.strip() for cell in cells[3:6]] for cells in lines[:2]] == [
        *(["grid", "any", "3"], ["grid", "turning", "3"]),
    ]


@pytest.mark.slow
def test_killed_interrupted_and_resumed(sweeps: Path) -> None:
    fewer = SWEEP.replace("episodes = 3", "episodes = 9").replace(', "lane_graph"', "")
    (sweeps / "small.toml").write_text(fewer)
    words = ("--workers", 1, "--out", "whole", "--no-report")
    whole = advdiff("sweep", "small.toml", *words, cwd=sweeps)
    assert whole.code == 0, whole.err
    first = begin("sweep", "small.toml", "--workers", 2, "--out", "broken", cwd=sweeps, hash_seed=2)
    _wait_for(sweeps / "broken", 2)
    workers = _children(first.pid)
    first.kill()
    first.communicate(timeout=HANG_S)
    _gone(workers)
    assert not (sweeps / "broken" / "episodes.parquet").exists()

    second = begin("sweep", "--resume", "broken", "--workers", 2, cwd=sweeps, hash_seed=3)
    before = len(_episodes(sweeps / "broken"))
    _wait_for(sweeps / "broken", min(before + 1, 9))
    second.send_signal(signal.SIGINT)
    _, said = second.communicate(timeout=HANG_S)
    if second.returncode != 0:  # it may have ended before the signal
        assert second.returncode == 130
        assert said.splitlines() == [f"{KEPT}; go on with advdiff-sumo sweep --resume broken"]

    damaged = _episodes(sweeps / "broken")[0]
    damaged.write_bytes(damaged.read_bytes()[:100])
    (sweeps / "broken" / "report.html").unlink(missing_ok=True)
    (sweeps / "broken" / "report.html").mkdir()
    done = advdiff("sweep", "small.toml", "--resume", "broken", "--workers", 2, cwd=sweeps, hash_seed=1)
    assert done.code == 0, done.err
    assert "no report: " in done.out  # a folder has the report's name; the results are not affected
    (sweeps / "broken" / "report.html").rmdir()
    for table in TABLES:
        assert (sweeps / "broken" / table).read_bytes() == (sweeps / "whole" / table).read_bytes(), table
    assert sorted(path.name for path in (sweeps / "broken").iterdir()) == sorted(
        path.name for path in (sweeps / "whole").iterdir()
    )


def _episodes(folder: Path) -> list[Path]:
    return sorted(p for p in (folder / "episodes").rglob("*") if p.is_file() and p.suffix != ".aside")


def _wait_for(folder: Path, episodes: int) -> None:
    until = time.monotonic() + HANG_S
    while len(_episodes(folder)) < episodes:
        assert time.monotonic() < until
        time.sleep(0.02)


def _children(pid: int) -> list[int]:
    """Return all processes below *pid*."""
    found = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return found + [below for child in found for below in _children(child)]


def _gone(pids: list[int]) -> None:
    """Wait until none of *pids* is alive, so that a killed parent leaves no process behind."""
    assert pids
    until = time.monotonic() + HANG_S
    while any(_alive(pid) for pid in pids):
        assert time.monotonic() < until, pids
        time.sleep(0.05)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


@pytest.mark.slow
def test_two_nets_with_the_same_name_are_distinguished(grid: Path, tmp_path: Path) -> None:
    for folder, speed in (("a", "13.9"), ("b", "8.3")):
        (tmp_path / folder).mkdir()
        net = re.sub(r'speed="[\d.]+"', f'speed="{speed}"', grid.read_text())
        (tmp_path / folder / "grid.net.xml").write_text(net)
    options = "episodes = 1\nhorizon_s = 1.0\n[scene]\nwarmup_s = 12.0\nmin_neighbours = 0\n"
    grids = '[grid]\nnets = ["a/grid.net.xml", "b/grid.net.xml"]\ntargets = ["IDM"]\nbackgrounds = ["sumo"]\n'
    (tmp_path / "two.toml").write_text(options + grids)
    done = advdiff("sweep", "two.toml", "--workers", 1, "--out", "s", cwd=tmp_path)
    assert done.code == 0, done.out + done.err
    assert all(f" {name} " in done.out for name in ("a-grid", "b-grid"))
    page = (tmp_path / "s" / "report.html").read_text()
    assert "on a-grid, b-grid." in page
    rows = pq.read_table(tmp_path / "s" / "episodes.parquet").to_pylist()
    assert {Path(row["net"]).parent.name for row in rows} == {"a", "b"}
    assert len({row["scene_key"] for row in rows}) == 2
