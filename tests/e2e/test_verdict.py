"""``advdiff-sumo verdict`` on folders of runs: of this version, of an earlier one, and on what is none."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.metrics.columns import LATER_COLUMNS
from tests.e2e.commands import Outcome
from tests.metrics.encounter_folder import encounter_folder


@pytest.fixture
def collided(tmp_path: Path) -> Path:
    """A run folder of hand-made episodes on a net of its own."""
    return encounter_folder(tmp_path)


def table(folder: Path, name: str = "episodes") -> list[dict]:
    return pq.read_table(folder / f"{name}.parquet").to_pylist()


def make_older(folder: Path, *, signals: bool) -> None:
    """Take away what earlier versions did not write."""
    for name in ("episodes", "collisions"):
        path = folder / f"{name}.parquet"
        whole = pq.read_table(path)
        pq.write_table(whole.drop_columns([c for c in whole.column_names if c in LATER_COLUMNS]), path)
    if not signals:
        (folder / "signals.parquet").unlink()


def test_the_same_verdicts_again(collided: Path, here: Callable[..., Outcome]) -> None:
    before = table(collided), table(collided, "collisions")
    assert [row["valid_failure"] for row in before[0]] == [True, False, False]
    assert [row["critical"] for row in before[0]] == [False, False, True]
    done = here("verdict", collided, "--workers", "2")
    assert done.code == 0, done.err
    assert "2 collisions of the target: 1 valid failures" in done.out
    assert (table(collided), table(collided, "collisions")) == before


def test_a_folder_of_an_earlier_version(collided: Path, here: Callable[..., Outcome]) -> None:
    before = table(collided)
    make_older(collided, signals=False)
    assert here("report", collided).code == 0
    done = here("verdict", collided, "--workers", "1")
    assert done.code == 0, done.err
    after = table(collided)
    for name in ("valid_failure", "preventable_by", "lawful", "other_breaches", "at_fault", "spare_m"):
        assert [row[name] for row in after] == [row[name] for row in before], name
    assert "Not judged: " in after[0]["verdict"]
    assert after[1]["verdict"].endswith("'north' entered the junction on red.")


def test_what_is_no_run_or_has_lost_its_net(collided: Path, here: Callable[..., Outcome]) -> None:
    nothing = here("verdict", collided.parent)
    assert nothing.code == 2
    assert "holds no run and no sweep" in nothing.err.replace("\n", " ")
    (collided.parent / "traffic_light.net.xml").unlink()
    lost = here("verdict", collided)
    assert lost.code == 2
    assert "is no longer there" in lost.err.replace("\n", " ")
    shutil.rmtree(collided)
    assert here("verdict", collided).code == 2


SWEEP = """
episodes = 2
horizon_s = 4.0
seeds = [3]
scene = { warmup_s = 8.0, scenes_per_warmup = 2, min_neighbours = 1 }

[grid]
nets = ["downtown"]
targets = ["IDM"]
backgrounds = ["sumo"]
"""


def test_a_sweep_and_one_of_an_earlier_version(tmp_path: Path, here: Callable[..., Outcome]) -> None:
    (tmp_path / "small.toml").write_text(SWEEP)
    assert here("sweep", tmp_path / "small.toml", "--out", tmp_path / "sweep", "--workers", "1").code == 0
    before = table(tmp_path / "sweep")
    assert here("verdict", tmp_path / "sweep", "--workers", "1").code == 0
    assert table(tmp_path / "sweep") == before
    assert here("results", tmp_path / "sweep", "--fail-if", "valid_failures > 0").code == 0
    make_older(tmp_path / "sweep", signals=True)
    settings = tmp_path / "sweep" / "sweep.toml"
    lines = [
        "keys = 'of old'" if line.startswith("keys") else line for line in settings.read_text().splitlines()
    ]
    settings.write_text("\n".join(lines))
    done = here("verdict", tmp_path / "sweep", "--workers", "1")
    assert done.code == 0, done.err
    after = table(tmp_path / "sweep")
    assert [row["valid_failure"] for row in after] == [row["valid_failure"] for row in before]
    assert list(after[0]) == list(before[0])
