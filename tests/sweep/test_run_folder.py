"""The run folder: what is refused, what is removed again, and tables with the same bytes."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.cli.summary import run_object
from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.data.run_tables import RunTables
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS
from advdiff_sumo.sim.run_store import TABLES, episode_tables
from advdiff_sumo.sweep.run_folder import FAILURES, RunFolder
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_files import DiskFullError
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Failed
from tests.sim.test_run_store import TIMING, record

BLANK = {"str": "word", "int64": 0, "float64": 0.5, "bool": False}


def settings(**options: Any) -> dict[str, Any]:
    return {"run": {"advdiff_sumo": "0"}, "options": {"net": "a", "seed": 0, "episodes": 3, **options}}


def rows(number: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    episode = {name: BLANK[column.dtype] for name, column in EPISODE_COLUMNS.items()}
    contact = {name: BLANK[column.dtype] for name, column in COLLISION_COLUMNS.items()}
    return episode | {"episode": number}, [contact | {"episode": number}] * number


def fill(folder: RunFolder, *numbers: int) -> RunFolder:
    for number in numbers:
        folder.add(number, StoredEpisode(episode_tables(record(number), *rows(number), TIMING), None))
    return folder


def content(folder: Path) -> Mapping[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.*"))}


def test_finished_episodes_become_tables(tmp_path: Path) -> None:
    folder = fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 0, 1, 2)
    folder.consolidate(finished=True)
    read = {name: pq.read_table(tmp_path / "run" / f"{name}.parquet") for name in TABLES}
    assert {name: table.column_names for name, table in read.items()} == {
        name: list(columns) for name, columns in TABLES.items()
    }
    assert read["episodes"]["episode"].to_pylist() == [0, 1, 2]
    assert read["collisions"]["episode"].to_pylist() == [1, 2, 2]
    assert read["states"].num_rows == 15
    assert set(content(tmp_path / "run")) == {"run.toml", *(f"{name}.parquet" for name in TABLES)}


def test_the_order_in_which_episodes_finish_does_not_matter(tmp_path: Path) -> None:
    for name, order in (("a", (0, 1, 2)), ("b", (2, 0, 1))):
        fill(RunFolder.create(tmp_path / name, settings(), resume=False), *order).consolidate(finished=True)
    assert content(tmp_path / "a") == content(tmp_path / "b")


def test_an_episode_counts_only_if_its_file_is_intact(tmp_path: Path) -> None:
    folder = fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 0, 1)
    stored = folder.path / "parts" / "episodes" / "00" / "000001"
    stored.write_bytes(stored.read_bytes()[:-9])  # as if the end of the file were lost
    assert folder.done() == [0]
    folder.consolidate(finished=False)
    assert pq.read_table(folder.path / "states.parquet")["episode"].unique().to_pylist() == [0]
    again = fill(RunFolder.create(tmp_path / "run", settings(), resume=True), 1)
    assert again.done() == [0, 1]


@pytest.mark.parametrize("finished", [False, True])
def test_a_resumed_run_gives_the_same_bytes(tmp_path: Path, *, finished: bool) -> None:
    fill(RunFolder.create(tmp_path / "a", settings(), resume=False), 0, 1, 2).consolidate(finished=True)
    begun = RunFolder.create(tmp_path / "b", settings(episodes=2), resume=False)
    fill(begun, 0, 1).consolidate(finished=finished)
    resumed = RunFolder.create(tmp_path / "b", settings(), resume=True)
    assert resumed.done() == [0, 1]
    fill(resumed, 2).consolidate(finished=True)
    assert content(tmp_path / "a") == content(tmp_path / "b")


def test_what_cannot_be_resumed(tmp_path: Path) -> None:
    path = tmp_path / "run"
    fill(RunFolder.create(path, settings(), resume=False), 0, 1, 2).consolidate(finished=True)
    before = content(path)
    with pytest.raises(FileError, match=r"run: already holds a run; choose a new --out$"):
        RunFolder.create(path, settings(), resume=False)
    with pytest.raises(ConfigError, match="that run had seed = 0, not 1; leave that option out"):
        RunFolder.create(path, settings(seed=1), resume=True)
    with pytest.raises(ConfigError, match="that run has 3 episodes; ask for as many"):
        RunFolder.create(path, settings(episodes=2), resume=True)
    assert content(path) == before
    assert not (path / "parts").exists()
    (path / "run.toml").write_text("[options\n")
    with pytest.raises(FileError, match=r"run\.toml: is damaged .*line 1.*choose a new --out"):
        RunFolder.create(path, settings(), resume=True)


@pytest.mark.parametrize("table", ["episodes", "states"])
def test_a_damaged_table_is_one_sentence_and_left_alone(tmp_path: Path, table: str) -> None:
    path = tmp_path / "run"
    fill(RunFolder.create(path, settings(), resume=False), 0, 1, 2).consolidate(finished=True)
    damaged = path / f"{table}.parquet"
    damaged.write_bytes(damaged.read_bytes()[:2000])
    before = content(path)
    words = rf"{table}\.parquet: is damaged .*; begin the run again: advdiff-sumo run --config .*run\.toml"
    with pytest.raises(FileError, match=words):
        RunFolder.create(path, settings(), resume=True)
    with pytest.raises(FileError, match=words):
        RunFolder(path).part(0)
    assert content(path) == before
    assert not list(path.glob("parts*"))


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    for resume in (False, True):
        with pytest.raises(FileError, match="holds other files; choose a new --out"):
            RunFolder.create(tmp_path, settings(), resume=resume)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_an_impossible_path_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for path in (tmp_path / "file", tmp_path / "file" / "below" / "it"):
        with pytest.raises(FileError, match=r"cannot be written .*; choose another --out"):
            RunFolder.create(path, settings(), resume=False)
    assert (tmp_path / "file").read_text() == "mine"


def test_a_full_disk_is_one_reason_and_one_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(store: Store, ballast_bytes: int) -> None:
        raise DiskFullError(store.path)

    monkeypatch.setattr(Store, "prepare", full)
    with pytest.raises(FileError) as told:
        RunFolder.create(tmp_path / "run", settings(), resume=False)
    assert (
        str(told.value) == f"{tmp_path / 'run'}: cannot be written (the disk is full); choose another --out"
    )


def test_discard_removes_only_what_was_created(tmp_path: Path) -> None:
    RunFolder.create(tmp_path / "new" / "deep" / "run", settings(), resume=False).discard()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "empty").mkdir()
    RunFolder.create(tmp_path / "empty", settings(), resume=False).discard()
    assert list((tmp_path / "empty").iterdir()) == []
    shared = RunFolder.create(tmp_path / "runs" / "mine", settings(), resume=False)
    (tmp_path / "runs" / "theirs").mkdir()
    shared.discard()
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["theirs"]


def test_discard_never_touches_episodes_or_an_older_run(tmp_path: Path) -> None:
    fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 0).discard()
    assert RunFolder(tmp_path / "run").done() == [0]
    RunFolder.create(tmp_path / "older", settings(), resume=False)
    RunFolder.create(tmp_path / "older", settings(), resume=True).discard()
    assert (tmp_path / "older" / "run.toml").exists()


def test_failures_are_kept_with_the_command_that_repeats_them(tmp_path: Path) -> None:
    folder = fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 0)
    failed = Failed("simulator_crashed", "SUMO crashed at 1.0 s of the episode", "Fatal Python error", 2)
    folder.add(1, StoredEpisode(episode_tables(record(1), *rows(1), TIMING), failed))
    folder.add(2, StoredEpisode({}, Failed("worker_died", "the worker was ended by SIGKILL")))
    assert folder.consolidate(finished=True) == 2
    assert pq.read_table(folder.path / "episodes.parquet")["episode"].to_pylist() == [0, 1]
    crashed, died = folder.failures()
    assert crashed == {
        "episode": 1,
        "kind": "simulator_crashed",
        "message": "SUMO crashed at 1.0 s of the episode",
        "log_tail": "Fatal Python error",
        "attempts": 2,
        "command": f"advdiff-sumo replay 1 --run {folder.path}",
    }
    assert (died["episode"], died["kind"]) == (2, "worker_died")
    whole = content(folder.path)
    again = RunFolder.create(folder.path, settings(), resume=True)
    assert again.done() == [0, 1, 2]
    assert again.done(retry_failed=True) == [0]
    kept = again.part(1)
    assert kept is not None
    assert kept.failed == failed
    again.consolidate(finished=True)
    assert content(folder.path) == whole


def test_a_failure_without_rows_is_kept_in_a_finished_run(tmp_path: Path) -> None:
    died = Failed("worker_died", "the worker was ended by SIGKILL", attempts=2)
    folder = fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 1)
    for number in (0, 2):
        folder.add(number, StoredEpisode({}, died))
    before = {number: part.failed for number, part in folder.episodes().items()}
    folder.consolidate(finished=True)
    parts = folder.episodes()
    assert {number: part.failed for number, part in parts.items()} == before == {0: died, 1: None, 2: died}
    assert [bool(parts[number].tables) for number in (0, 1, 2)] == [False, True, False]
    assert folder.part(2) == StoredEpisode({}, died)
    assert StoredEpisode.row_and_failure(parts[2].to_bytes()) == (None, died)
    with pytest.raises(ConfigError, match="that run has 3 episodes; ask for as many"):
        RunFolder.create(folder.path, settings(episodes=2), resume=True)


def test_no_file_of_failures_if_nothing_failed(tmp_path: Path) -> None:
    folder = fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 0)
    (folder.path / FAILURES).write_bytes(b"of before")
    folder.consolidate(finished=True)
    assert not (folder.path / FAILURES).exists()
    assert folder.failures() == []


def test_a_net_that_has_changed_is_noticed(tmp_path: Path) -> None:
    asked = settings()
    begun = {**asked, "run": {"inputs": "a1"}}
    fill(RunFolder.create(tmp_path / "run", begun, resume=False), 0).consolidate(finished=False)
    RunFolder.create(tmp_path / "run", begun, resume=True)
    with pytest.raises(ConfigError, match="a net, demand or log is not what it was"):
        RunFolder.create(tmp_path / "run", {**asked, "run": {"inputs": "b2"}}, resume=True)


def test_an_episode_that_failed_without_a_row_counts_in_every_summary(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", settings(), resume=False)
    fill(folder, 0, 1).add(2, StoredEpisode({}, Failed("worker_died", "its worker died")))
    folder.consolidate(finished=True)
    told = run_object(folder.path)
    assert (told["episodes"], told["finished"], told["failed"]) == (3, 2, {"worker_died": 1})
    tables = RunTables(folder.path)
    assert [row["episode"] for row in tables.all_episodes()] == [0, 1, 2]
    assert tables.unstarted(tables.all_episodes()) == []


def test_a_continued_run_keeps_the_versions_that_it_began_with(tmp_path: Path) -> None:
    path, now = tmp_path / "run", settings()
    before = {**now, "run": {"advdiff_sumo": "0.1", "libsumo": "1.20"}}
    fill(RunFolder.create(path, before, resume=False), 0).consolidate(finished=False)
    for _ in range(2):
        RunFolder.create(path, now, resume=True)
        kept = tomllib.loads((path / "run.toml").read_text())["run"]
        assert kept == {"advdiff_sumo": "0", "begun_with": {"advdiff_sumo": "0.1"}}


def test_tables_catch_up_with_the_episodes_of_an_interrupted_run(tmp_path: Path) -> None:
    folder = fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 0)
    folder.catch_up()
    tables = RunTables(folder.path)
    assert tables.rows("episodes").num_rows == 1
    before = tables.path("episodes").stat().st_mtime_ns
    folder.catch_up()
    assert tables.path("episodes").stat().st_mtime_ns == before, "nothing was added"
    fill(folder, 1).catch_up()
    assert tables.rows("episodes").num_rows == 2


def test_tables_of_a_run_that_ends_during_the_reading_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While another process reads a run, the run ends: it writes its tables and removes the single files."""
    folder = fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 0, 1, 2)
    numbers = folder.done()
    assert folder.consolidate(finished=True) == 3
    whole = content(folder.path)
    monkeypatch.setattr(RunFolder, "done", lambda _self: numbers)
    with pytest.raises(FileError, match="has changed while it was read"):
        folder.consolidate(finished=False)
    assert content(folder.path) == whole


def test_the_command_that_repeats_an_episode_quotes_its_folder(tmp_path: Path) -> None:
    row = RunFolder(tmp_path / "my runs").failure_row(2, Failed("timeout", "not finished after 3 s"))
    assert shlex.split(row["command"]) == ["advdiff-sumo", "replay", "2", "--run", str(tmp_path / "my runs")]
