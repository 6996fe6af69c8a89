"""Pedestrians in runs, from the command line."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import advdiff

PEOPLE = ("--set", "scene.pedestrians_per_km=15", "--set", "scene.warmup_s=10", "--seed", 3)


@pytest.mark.slow
def test_people_walk_in_a_run(tmp_path: Path) -> None:
    options = ("--net", "downtown-people", "--episodes", 1, "--horizon", 3, "--out", "run", "--quiet")
    done = advdiff("run", *options, *PEOPLE, cwd=tmp_path)
    assert done.code == 0, done.err
    states = pq.read_table(tmp_path / "run" / "states.parquet")
    rows = Counter(zip(states["class"].to_pylist(), states["controller"].to_pylist(), strict=True))
    assert rows["pedestrian", "sumo"] > 100
    assert {who for kind, who in rows if kind == "pedestrian"} == {"sumo"}


@pytest.mark.slow
def test_people_on_a_net_without_crossings_are_refused(tmp_path: Path) -> None:
    done = advdiff("run", "--net", "downtown", "--episodes", 1, *PEOPLE, "--out", "run", cwd=tmp_path)
    assert done.code == 2
    said = " ".join(done.err.split())
    assert "has no sidewalks with crossings for people on foot; convert it with --crossings guess" in said
