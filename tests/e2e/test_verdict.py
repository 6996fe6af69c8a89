"""``advdiff-sumo verdict`` on folders of runs: of this version, of an earlier one, and on what is none."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.columns import LATER_COLUMNS
from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row
from advdiff_sumo.sim.episode import Timing
from advdiff_sumo.sim.run_store import episode_tables
from advdiff_sumo.sweep.episode_result import Part
from advdiff_sumo.sweep.run_folder import RunFolder
from tests.e2e.commands import Outcome
from tests.metrics.encounters import braking, crossing, driven, record_of, signals_of, straight


@pytest.fixture
def collided(tmp_path: Path) -> Path:
    """A run folder of two hand-made episodes on a net of its own: a valid failure, and a red-light runner."""
    road = crossing(tmp_path, "traffic_light")
    ego = straight("ego", (-150, -1.6), 0, 12, steps=81)
    lead = driven("lead", (-116, -1.6), 0, braking(12, 0.5, 3.0, 81))
    lights = signals_of(road, {("WC_1", "CE_1"): "G", ("SC_0", "CN_0"): "r"}, 81)
    cars = (
        straight("east", (-30, -1.6), 0, 10, steps=81),
        straight("north", (1.6, -31), 1.5707963, 10, steps=81),
    )
    folder = RunFolder.create(tmp_path / "run", {"options": {"net": str(road.path), "episodes": 2}}, False)
    for number, crew in enumerate(((ego, lead), cars)):
        record = record_of(*crew, signals=lights, episode_number=number)
        assert target_collision(record, collisions(record)) is not None
        rows = episode_row(record, road), collision_rows(record, road)
        folder.add(number, Part(episode_tables(record, *rows, Timing(1.0, (), ())), None))
    folder.consolidate(finished=True)
    return folder.path


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
    assert [row["valid_failure"] for row in before[0]] == [True, False]
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
    assert "run.toml: is missing" in nothing.err.replace("\n", "")
    (collided.parent / "traffic_light.net.xml").unlink()
    lost = here("verdict", collided)
    assert lost.code == 2
    assert "is no longer there" in lost.err.replace("\n", " ")
    shutil.rmtree(collided)
    assert here("verdict", collided).code == 2
