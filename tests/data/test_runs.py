"""Run folders read as logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from advdiff_sumo.core.errors import LogError, UnknownNameError
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data import open_log
from advdiff_sumo.data.runs import RunReader


def row(episode: int, step: int, agent: str, x: float, **other: Any) -> dict[str, Any]:
    base = {"class": "car", "length_m": 4.5, "width_m": 1.8, "y_m": 1.0, "yaw_rad": 0.0, "speed_mps": 10.0}
    base |= {"is_target": agent == "t", "time_s": 0.1 * step}
    return {"episode": episode, "step": step, "agent": agent, "x_m": x, **base, **other}


ROWS = [
    *(row(0, k, "t", float(k)) for k in range(11)),
    *(row(0, k, "b", 50.0, **{"class": "bus", "length_m": 12.0}) for k in range(3, 11)),
    *(row(2, k, "t", 2.0 * k) for k in range(3)),
]


def write(folder: Path, rows: list[dict[str, Any]], net: str = "downtown") -> Path:
    folder.mkdir(exist_ok=True)
    pq.write_table(pa.Table.from_pylist(rows), folder / "states.parquet")
    (folder / "run.toml").write_text(f'[run]\n[options]\nnet = "{net}"\n')
    return folder


def test_an_episode_is_a_drive_of_the_target(tmp_path: Path) -> None:
    reader = open_log(write(tmp_path / "mine", ROWS))
    assert isinstance(reader, RunReader)
    assert reader.names() == ["mine-0000", "mine-0002"]
    drive = reader.read("mine-0000")
    assert drive.location == "downtown"
    assert drive.tracks.ids[drive.ego] == "t"
    assert drive.tracks.dt_s == 0.1
    bus = drive.tracks.index["b"]
    assert drive.tracks.classes[bus] == AgentClass.BUS
    assert drive.tracks.size_m[bus].tolist() == [12.0, 1.8]
    assert drive.tracks.valid[bus].tolist() == [False] * 3 + [True] * 8
    np.testing.assert_array_equal(drive.tracks.xy_m[drive.ego, :, 0], np.arange(11.0))
    assert not drive.parked.any()
    assert [scene.tracks.steps for scene in reader.scenes()] == [11, 3]


def test_an_episode_of_a_sweep_has_its_own_net(tmp_path: Path) -> None:
    folder = write(tmp_path / "mine", ROWS)
    (folder / "run.toml").rename(folder / "sweep.toml")
    nets = [{"episode": 0, "net": "motorway"}, {"episode": 1, "net": "downtown"}]
    pq.write_table(pa.Table.from_pylist(nets), folder / "episodes.parquet")
    assert RunReader(folder).read("mine-0000").location == "motorway"
    with pytest.raises(
        LogError, match=r"episodes.parquet: does not say which net the run had \(2\); give the f"
    ):
        RunReader(folder).read("mine-0002")


def test_an_unknown_episode_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="mine-0002"):
        RunReader(write(tmp_path / "mine", ROWS)).read("mine-0003")


def test_two_targets_are_refused(tmp_path: Path) -> None:
    rows = [*ROWS, row(0, 0, "u", 3.0, is_target=True)]
    with pytest.raises(LogError, match="episode 0 cannot be used"):
        RunReader(write(tmp_path / "mine", rows)).read("mine-0000")


def test_other_tables_are_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "mine", [{"episode": 1}])
    with pytest.raises(LogError, match="lacks the columns agent"):
        RunReader(folder).names()
    (folder / "states.parquet").write_bytes(b"PAR1")
    with pytest.raises(LogError, match="is damaged"):
        RunReader(folder).names()


def test_a_run_that_does_not_name_its_net(tmp_path: Path) -> None:
    folder = write(tmp_path / "mine", ROWS)
    (folder / "run.toml").write_text("[run]\n")
    with pytest.raises(LogError, match="does not say which net"):
        RunReader(folder).read("mine-0000")
