"""The run folder: what is refused, what is taken away again, and tables that come out the same."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord, MadePlans
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS
from advdiff_sumo.sim.episode import Timing
from advdiff_sumo.sim.run_store import TABLES, RunFolder, natural_table, plans_table, states_table, timing_row

BLANK = {"str": "word", "int64": 0, "float64": 0.5, "bool": False}
TIMING = Timing(wall_s=0.1, target_plans_s=(0.01, 0.03))


def settings(**options: Any) -> dict[str, Any]:
    return {"run": {"advdiff_sumo": "0"}, "options": {"net": "a", "seed": 0, "episodes": 3, **options}}


def record(number: int) -> EpisodeRecord:
    """The target is there for three instants, a bus for the last two."""
    valid = np.array([[True, True, True], [False, True, True]])
    x = np.array([[0.0, 1.0, 2.0], [np.nan, 8.0, 8.0]])
    tracks = Tracks(
        ids=("ego", "bus7"),
        classes=np.array([AgentClass.CAR, AgentClass.BUS]),
        size_m=np.array([[4.5, 1.8], [12.0, 2.5]]),
        xy_m=np.stack((x, 3.0 + 0.0 * x), axis=-1),
        yaw_rad=0.0 * x,
        speed_mps=10.0 + 0.0 * x,
        valid=valid,
        t0_s=0.0,
        dt_s=0.1,
    )
    moved = np.where(valid, [[Controller.PLANNER], [Controller.POLICY]], Controller.ABSENT)
    return EpisodeRecord(number, 5, f"scene{number}", tracks, 0, moved, ("e",), EndReason.HORIZON)


def rows(number: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    episode = {name: BLANK[column.dtype] for name, column in EPISODE_COLUMNS.items()}
    contact = {name: BLANK[column.dtype] for name, column in COLLISION_COLUMNS.items()}
    return episode | {"episode": number}, [contact | {"episode": number}] * number


def fill(folder: RunFolder, *numbers: int) -> RunFolder:
    for number in numbers:
        folder.add(record(number), *rows(number), TIMING)
    return folder


def content(folder: Path) -> Mapping[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.*"))}


def test_states_by_hand() -> None:
    table = states_table(record(4)).to_pydict()
    assert table["agent"] == ["ego", "ego", "ego", "bus7", "bus7"]
    assert table["step"] == [0, 1, 2, 1, 2]
    assert table["time_s"] == [0.0, 0.1, 0.2, 0.1, 0.2]
    assert table["x_m"] == [0.0, 1.0, 2.0, 8.0, 8.0]
    assert table["class"] == ["car"] * 3 + ["bus"] * 2
    assert table["controller"] == ["planner"] * 3 + ["policy"] * 2
    assert table["is_target"] == [True] * 3 + [False] * 2
    assert set(table["episode"]) == {4}
    assert (table["length_m"][3], table["width_m"][3]) == (12.0, 2.5)


def test_plans_by_hand() -> None:
    nan = np.nan
    first = MadePlans(
        0.0, 0.5, ("ego", "bus7"), np.array([[[1.234, 0.0], [nan, nan]], [[nan, nan], [7.0, -0.001]]])
    )
    later = MadePlans(0.5, 0.5, ("ego",), np.array([[[2.0, 0.0], [3.0, 1.0]]]))
    table = plans_table(replace(record(4), plans=(first, later))).to_pydict()
    assert table == {
        "episode": [4] * 4,
        "made_s": [0.0, 0.0, 0.5, 0.5],
        "agent": ["ego", "bus7", "ego", "ego"],
        "time_s": [0.5, 1.0, 1.0, 1.5],
        "x_m": [1.23, 7.0, 2.0, 3.0],
        "y_m": [0.0, 0.0, 0.0, 1.0],
    }
    assert plans_table(record(4)).num_rows == 0


def test_the_unattacked_by_hand() -> None:
    natural = replace(record(4).tracks.rows([1, 0]), dt_s=0.5)
    table = natural_table(replace(record(4), natural=natural)).to_pydict()
    assert table["agent"] == ["bus7", "bus7", "ego", "ego", "ego"]
    assert table["time_s"] == [0.5, 1.0, 0.0, 0.5, 1.0]
    assert table["is_target"] == [False, False, True, True, True]
    assert table["x_m"] == [8.0, 8.0, 0.0, 1.0, 2.0]
    assert list(table) == list(TABLES["unattacked"])
    assert natural_table(record(4)).num_rows == 0


def test_timing_by_hand() -> None:
    row = timing_row(record(1), TIMING)
    assert math.isclose(row["simulated_s"], 0.2)
    assert math.isclose(row["real_time_factor"], 2.0)
    assert math.isclose(row["target_plan_p50_s"], 0.02)
    assert math.isclose(row["target_plan_p99_s"], 0.0298)
    assert row["background_plan_p50_s"] is None
    assert list(row) == list(TABLES["timing"])


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


def test_an_episode_counts_once_all_of_it_is_there(tmp_path: Path) -> None:
    folder = fill(RunFolder.create(tmp_path / "run", settings(), resume=False), 0, 1)
    (folder.path / "parts" / "000001.done").unlink()  # as if it was killed before the end of add()
    (folder.path / "parts" / "000001.states.parquet").write_bytes(b"PAR1 half")
    assert folder.done() == [0]
    folder.consolidate(finished=False)
    assert pq.read_table(folder.path / "states.parquet")["episode"].unique().to_pylist() == [0]
    again = fill(RunFolder.create(tmp_path / "run", settings(), resume=True), 1)
    assert again.done() == [0, 1]


@pytest.mark.parametrize("finished", [False, True])
def test_resumed_gives_the_bytes_of_undisturbed(tmp_path: Path, *, finished: bool) -> None:
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
    with pytest.raises(FileError, match=r"run: already holds a run; choose a new --out, or add --resume"):
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


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    for resume in (False, True):
        with pytest.raises(FileError, match="holds other files; choose a new --out"):
            RunFolder.create(tmp_path, settings(), resume=resume)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_path_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for path in (tmp_path / "file", tmp_path / "file" / "below" / "it"):
        with pytest.raises(FileError, match=r"cannot be written .*; choose another --out"):
            RunFolder.create(path, settings(), resume=False)
    assert (tmp_path / "file").read_text() == "mine"


def test_discard_takes_away_what_was_made_and_no_more(tmp_path: Path) -> None:
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
