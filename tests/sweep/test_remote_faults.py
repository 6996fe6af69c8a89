"""A sweep whose target runs in separate processes that crash, hang, exit and plan NaN at random."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.sweep.consolidate import read_rows
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.job_plan import plan_sweep
from advdiff_sumo.sweep.spec import SweepSpec
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep
from advdiff_sumo.sweep.tasks import WorkerLimits
from tests.hang_guard import with_time
from tests.planners.remote.test_remote_planner import running
from tests.sweep.conftest import values

SERVER = '''
"""Coasts; in every plan it draws whether it crashes, hangs, exits, or plans NaN."""
import ctypes
import sys
import tempfile
import time

import numpy as np

from advdiff_sumo.planner_kit import Controls, serve

CRASHES, HANGS, NANS, EXITS = map(float, sys.argv[1:5])


class Draws:
    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        draw, accel = rng.random(), np.zeros(10)
        if draw < CRASHES:
            ctypes.string_at(0)
        elif draw < CRASHES + HANGS:
            tempfile.mkstemp(dir=sys.argv[5])
            time.sleep(600)
        elif draw < CRASHES + HANGS + EXITS:
            sys.exit(4)
        elif draw < CRASHES + HANGS + EXITS + NANS:
            accel[2] = np.nan
        return Controls(accel, np.zeros(10), 0.1), memory


serve(Draws)
'''
pytestmark = pytest.mark.slow

KINDS = {"planner_crashed", "planner_timeout", "plan_refused"}


def test_every_episode_has_its_row_and_no_process_stays(
    place: Path, tmp_path: Path, limits: WorkerLimits
) -> None:
    server = tmp_path / "draws_server.py"
    server.write_text(SERVER)
    rows, failures = with_time(lambda limit_s: attempt(server, place, tmp_path, limits, limit_s), 8.0)
    assert len(rows) == 12
    kinds = [row["failure_kind"] for row in rows if row["end"] == "failed"]
    assert set(kinds) == KINDS
    assert any(row["end"] != "failed" for row in rows)
    messages = {row["message"] for row in failures}
    for words in ("was ended by SIGSEGV", "ended with exit code 4", "did not answer MakePlan within"):
        assert any(words in message for message in messages), words
    while running("draws_server.py"):  # a keeper ends the server after its worker has ended
        time.sleep(0.02)


def attempt(
    server: Path, place: Path, folder: Path, limits: WorkerLimits, limit_s: float
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]] | None:
    """Return the rows of episodes and failures; None if a plan was late that did not hang."""
    hangs = folder / f"hangs-{limit_s:g}"
    hangs.mkdir()
    target = {
        "name": f"exec:{sys.executable} {server} 0.05 0.05 0.04 0.04 {hangs}",
        "options": {"plan_timeout_s": limit_s},
    }
    grid = {"nets": [str(place / "small.net.xml")], "targets": [target], "backgrounds": ["sumo"]}
    plan = plan_sweep(SweepSpec.of(values(place, grid=grid, episodes=12), "test"))
    store = open_store(folder / f"s-{limit_s:g}", plan, 1, resume=False)
    assert (
        run_sweep(plan, store, RemainingJobs.of(plan, store), ProcessExecutor(1, limits), 0, lambda *_: None)
        == 0
    )
    failures = read_rows(store.path, "failures")
    late = [row for row in failures if row["kind"] == "planner_timeout"]
    if len(late) > len(list(hangs.iterdir())):
        return None
    return pq.read_table(store.path / "episodes.parquet").to_pylist(), failures
