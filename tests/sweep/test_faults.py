"""Workers are killed, crash, hang, raise, exit and use up memory: all other results are as if nothing had failed."""

from __future__ import annotations

import os
import random
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.sweep.consolidate import read_rows, tables_of
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.job_plan import SweepPlan
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import WorkerLimits
from tests.sweep.conftest import bytes_of, planned, serially

pytestmark = pytest.mark.slow

FAULTS = ("none", "raises", "nan", "hangs", "eats", "segfaults", "exits")
KINDS = {
    "raises": "planner_error",
    "nan": "plan_refused",
    "hangs": "timeout",
    "eats": "out_of_memory",
    "segfaults": "planner_crashed",
    "exits": "planner_error",
}
LEAST_TIMEOUT_S, TIMES_THE_SLOWEST = 45.0, 20.0


@pytest.fixture(scope="module")
def plan(place: Path) -> SweepPlan:
    """Two episodes of a planner of each kind."""
    return planned(place, FAULTS)


@pytest.fixture(scope="module")
def undisturbed(plan: SweepPlan, tmp_path_factory: pytest.TempPathFactory) -> Store:
    """The sweep without faults, except that one planner always plans NaN."""
    return serially(plan, tmp_path_factory.mktemp("undisturbed") / "s")


@pytest.fixture
def ill(place: Path) -> Iterator[Path]:
    """While this file exists, the planners have their faults."""
    flag = place / "ill"
    flag.touch()
    yield flag
    flag.unlink(missing_ok=True)


@pytest.fixture
def tight(undisturbed: Store, tmp_path: Path) -> WorkerLimits:
    """Limits that a healthy episode keeps on this machine, however busy, and a faulty one does not."""
    logs = tmp_path / "logs"
    logs.mkdir()
    slowest = max(row["wall_s"] for row in read_rows(undisturbed.path, "timing"))
    return WorkerLimits(max(LEAST_TIMEOUT_S, TIMES_THE_SLOWEST * slowest), 600, 6, 0.9, logs)


def run(plan: SweepPlan, store: Store, executor: ProcessExecutor, on_episode: Any = None, **more: Any) -> int:
    todo = RemainingJobs.of(plan, store, **more)
    return run_sweep(plan, store, todo, executor, 4, on_episode or (lambda *_: None))


def test_every_fault_costs_its_own_episode_only(
    plan: SweepPlan, undisturbed: Store, ill: Path, tight: WorkerLimits, tmp_path: Path
) -> None:
    store = open_store(tmp_path / "s", plan, 2, resume=False)
    executor = ProcessExecutor(2, tight)
    rng = random.Random(1)  # noqa: S311 - it chooses the worker to kill, no secret
    kills = []

    def kill_someone(*_: object) -> None:
        workers = executor.workers()
        if workers and len(kills) < 4:
            kills.append(rng.choice(workers))
            os.kill(kills[-1], signal.SIGKILL)

    assert run(plan, store, executor, kill_someone) == 0
    assert len(kills) == 4
    failures = read_rows(store.path, "failures")
    told = {
        (row["target_options"].split('"fault":"')[1].split('"')[0], row["number"]): row for row in failures
    }
    assert {key: row["kind"] for key, row in told.items()} == {
        (fault, number): kind for fault, kind in KINDS.items() for number in (0, 1)
    }
    assert "thinking" in told["hangs", 0]["log_tail"]
    assert "in hangs" in told["hangs", 0]["log_tail"]  # where it was stuck
    assert "SIGSEGV" in told["segfaults", 0]["message"]
    assert "in segfaults" in told["segfaults", 0]["log_tail"]
    assert told["segfaults", 0]["attempts"] == 5
    assert "out of ideas" in told["raises", 0]["log_tail"]
    for row in failures:
        assert row["command"] == f"advdiff-sumo replay {row['key']} --sweep {store.path}"

    well = {row["key"]: row for row in read_rows(undisturbed.path, "episodes")}
    failed = {row["key"] for row in failures}
    finished = [row for row in read_rows(store.path, "episodes") if row["key"] not in failed]
    assert [row["number"] for row in finished] == [0, 1]
    assert all(row == well[row["key"]] for row in finished)

    ill.unlink()
    again = open_store(store.path, plan, 2, resume=True)
    assert run(plan, again, ProcessExecutor(2, tight), retry_failed=True) == 0
    assert bytes_of(again) == bytes_of(undisturbed)


def test_only_what_is_missing_or_damaged_is_run(
    plan: SweepPlan, undisturbed: Store, limits: WorkerLimits, tmp_path: Path
) -> None:
    store = open_store(tmp_path / "s", plan, 1, resume=False)
    first = RemainingJobs.of(plan, store, limit=3)
    assert len(first.jobs) == 3
    told: list[object] = []
    missing = run_sweep(plan, store, first, ProcessExecutor(1, limits), 0, lambda *row: told.append(row))
    assert (missing, len(told)) == (len(plan.jobs) - 3, 3)
    assert [row["episode"] for row in read_rows(store.path, "episodes")] == [0, 1, 2]
    paths = [store.path / "episodes" / job.key[:2] / job.key for job in plan.jobs]
    paths[0].write_bytes(paths[0].read_bytes()[:-7])
    paths[1].unlink()
    store = open_store(tmp_path / "s", plan, 1, resume=True)
    todo = RemainingJobs.of(plan, store)
    assert [job.index for job in todo.jobs] == [0, 1, *range(3, len(plan.jobs))]
    assert run_sweep(plan, store, todo, ProcessExecutor(2, limits), 0, lambda *_: None) == 0
    assert bytes_of(store) == bytes_of(undisturbed)


def test_damaged_tables_are_written_again(plan: SweepPlan, undisturbed: Store) -> None:
    before = bytes_of(undisturbed)
    path = undisturbed.path / "episodes.parquet"
    path.write_bytes(path.read_bytes()[:-30])
    assert tables_of(undisturbed, plan) == 0
    assert bytes_of(undisturbed) == before
    stamp = path.stat().st_mtime_ns
    assert tables_of(undisturbed, plan) == 0
    assert path.stat().st_mtime_ns == stamp  # intact: not written again


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 14 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=14m", "tmpfs", str(disk)]
    try:
        done = subprocess.run(mount, capture_output=True, text=True, check=False)
    except OSError as error:
        pytest.skip(f"no mount here: {error}")
    if done.returncode:
        pytest.skip(f"mounting is not permitted: {done.stderr.strip()}")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


def test_a_full_disk_is_one_sentence_and_loses_nothing(
    plan: SweepPlan, undisturbed: Store, limits: WorkerLimits, small_disk: Path
) -> None:
    store = open_store(small_disk / "s", plan, 2, resume=False)
    filler = small_disk / "filler"
    told: list[object] = []

    def fill(*_: object) -> None:
        told.append(_)
        if len(told) == 2:
            with filler.open("wb", buffering=0) as file:
                try:
                    while True:
                        file.write(bytes(4096))
                except OSError:
                    pass

    with pytest.raises(FileError) as caught:
        run(plan, store, ProcessExecutor(2, limits), fill)
    done = sum(store.has(job.key) for job in plan.jobs)
    assert str(caught.value) == (
        f"{store.path}: the disk is full with {len(plan.jobs) - done} episodes left to do; all that had finished is "
        "stored; free some space and go on with --resume"
    )
    assert done >= 4  # two before, the one that did not fit at first, and the running one
    filler.unlink()
    again = open_store(store.path, plan, 2, resume=True)
    assert run(plan, again, ProcessExecutor(2, limits)) == 0
    assert bytes_of(again) == bytes_of(undisturbed)


def test_the_workers_memory_is_recorded(undisturbed: Store) -> None:
    timing = pq.read_table(undisturbed.path / "timing.parquet").to_pylist()
    assert {row["worker"] for row in timing} == {os.getpid()}
    assert all(50.0 < row["rss_mb"] <= row["peak_mb"] < 4000.0 for row in timing)
