"""Results do not depend on the executor, on the number of workers, or on the order."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest

from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.page import report_html
from advdiff_sumo.sweep.consolidate import read_rows, tables_of
from advdiff_sumo.sweep.executors import ProcessExecutor, SerialExecutor
from advdiff_sumo.sweep.fingerprint import file_digest, net_files
from advdiff_sumo.sweep.job_plan import SweepPlan
from advdiff_sumo.sweep.repeat import of_sweep, repeat
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Failed, SceneTask, WorkerLimits
from advdiff_sumo.sweep.work import perform
from tests.sweep.conftest import bytes_of, planned, serially


@pytest.fixture(scope="module")
def plan(place: Path) -> SweepPlan:
    grid = {
        "nets": [str(place / "small.net.xml")],
        "targets": ["IDM", "lane_graph"],
        "backgrounds": ["sumo", "replay"],
    }
    return planned(place, grid=grid, episodes=3)


@pytest.fixture(scope="module")
def one_by_one(plan: SweepPlan, tmp_path_factory: pytest.TempPathFactory) -> Store:
    return serially(plan, tmp_path_factory.mktemp("serial") / "s")


def test_two_replaced_workers_in_reverse_order_give_the_same_bytes(
    plan: SweepPlan, one_by_one: Store, limits: WorkerLimits, tmp_path: Path
) -> None:
    store = open_store(tmp_path / "s", plan, 2, resume=False)
    todo = RemainingJobs.of(plan, store)
    backwards = replace(todo, jobs=todo.jobs[::-1])
    often = replace(limits, tasks=3)
    assert run_sweep(plan, store, backwards, ProcessExecutor(2, often), 0, lambda *_: None) == 0
    assert bytes_of(store) == bytes_of(one_by_one)
    settings = (one_by_one.path / "sweep.toml").read_bytes()
    (store.path / "sweep.toml").write_bytes(settings)  # the version may have changed in between
    pages = [report_html(FinishedRun.read(folder.path)) for folder in (store, one_by_one)]
    assert pages[0] == pages[1]  # both folders have the same name


def test_a_worker_with_much_memory_is_replaced_before_its_next_task(
    plan: SweepPlan, one_by_one: Store, limits: WorkerLimits, tmp_path: Path
) -> None:
    greedy = replace(limits, recycle_share=0.001)  # reached by any worker that has performed a task
    store = open_store(tmp_path / "s", plan, 1, resume=False)
    todo = RemainingJobs.of(plan, store, limit=3)
    run_sweep(plan, store, todo, ProcessExecutor(1, greedy), 0, lambda *_: None)
    parts = [store.read(job.key) for job in todo.jobs]
    pids = {part.tables["timing"]["worker"][0].as_py() for part in parts if part is not None}
    assert len(pids) == 3
    for job, part in zip(todo.jobs, parts, strict=True):
        again = one_by_one.read(job.key)
        assert again is not None
        assert part is not None
        assert part.tables["states"].equals(again.tables["states"])


def test_too_few_stored_seed_scenes_are_made_again(
    plan: SweepPlan, one_by_one: Store, tmp_path: Path
) -> None:
    """The folder may be of a sweep with fewer episodes."""
    store = open_store(tmp_path / "s", plan, 1, resume=False)
    first = plan.batches[plan.jobs[0].batch]
    net = file_digest(*net_files(first.options.net))
    outcome = perform(SceneTask(first.key, first.options, first.number, 1, net))
    assert len(outcome.product) == 1
    store.write_scenes(first.key, outcome.product, 1)
    todo = RemainingJobs.of(plan, store, limit=2)
    assert [job.scene_index for job in todo.jobs] == [0, 1]
    run_sweep(plan, store, todo, SerialExecutor(), 0, lambda *_: None)
    for job in todo.jobs:
        part, same = store.read(job.key), one_by_one.read(job.key)
        assert part is not None
        assert same is not None
        assert part.tables["episodes"] == same.tables["episodes"]


def test_an_episode_is_repeated_exactly(plan: SweepPlan, one_by_one: Store) -> None:
    job = plan.jobs[-1]
    before = of_sweep(job.key[:9], None, one_by_one.path.parent)
    assert before.job == job
    assert repeat(before).same is True


def test_a_repetition_ignores_columns_of_a_search(plan: SweepPlan, one_by_one: Store, tmp_path: Path) -> None:
    store = Store(shutil.copytree(one_by_one.path, tmp_path / "s"))
    job = plan.jobs[0]
    part = store.read(job.key)
    assert part is not None
    tables = dict(part.tables)
    for name in ("episodes", "collisions"):
        rows = [{**row, "solvable": True, "unavoidable": False} for row in tables[name].to_pylist()]
        tables[name] = pa.Table.from_pylist(rows, schema=tables[name].schema)
    store.write(job.key, StoredEpisode(tables, None).to_bytes())
    assert repeat(of_sweep(job.key, store.path, tmp_path)).same is True
    tables["states"] = tables["states"].slice(1)
    store.write(job.key, StoredEpisode(tables, None).to_bytes())
    assert repeat(of_sweep(job.key, store.path, tmp_path)).same is False


def test_tables_follow_an_episode_that_was_run_again(
    plan: SweepPlan, one_by_one: Store, tmp_path: Path
) -> None:
    store = Store(shutil.copytree(one_by_one.path, tmp_path / "s"))
    assert tables_of(store, plan) == 0
    assert read_rows(store.path, "failures") == []
    again = StoredEpisode({}, Failed("timeout", "not finished after 1 s"))
    store.write(plan.jobs[1].key, again.to_bytes())
    assert tables_of(store, plan) == 0
    assert [row["key"] for row in read_rows(store.path, "failures")] == [plan.jobs[1].key]


def test_cached_plans_change_no_result(place: Path, limits: WorkerLimits, tmp_path: Path) -> None:
    late = {"name": "lane_graph", "options": {"defects": ["late:strong"]}}
    grid = {
        "nets": [str(place / "small.net.xml")],
        "targets": ["lane_graph", late],
        "backgrounds": ["scripted"],
    }
    plan = planned(place, grid=grid)
    fresh = open_store(tmp_path / "fresh", plan, 1, resume=False)
    each_anew = ProcessExecutor(1, replace(limits, tasks=1))
    assert run_sweep(plan, fresh, RemainingJobs.of(plan, fresh), each_anew, 0, lambda *_: None) == 0
    assert bytes_of(serially(plan, tmp_path / "serial")) == bytes_of(fresh)


COUNTS = '''
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Tracks


class Counts:
    """Moves nobody, and keeps state, which no policy should: the number of its calls."""

    def __init__(self):
        self.asked = 0

    def start(self, road, scene, log, rng):
        return None

    def plan(self, road, scene, memory, rng):
        self.asked += 1
        if self.asked > 8:
            raise RuntimeError("asked again")
        return JointPlan(Tracks.empty(12)), memory
'''


def test_plans_of_a_users_policy_are_not_cached(place: Path, tmp_path: Path) -> None:
    (place / "counting_policies.py").write_text(COUNTS)
    grid = {
        "nets": [str(place / "small.net.xml")],
        "targets": ["lane_graph", {"name": "lane_graph", "options": {"defects": ["signals:strong"]}}],
        "backgrounds": ["counting_policies:Counts"],
    }
    store = open_store(tmp_path / "s", plan := planned(place, grid=grid), 1, resume=False)
    run_sweep(plan, store, RemainingJobs.of(plan, store), SerialExecutor(), 0, lambda *_: None)
    failures = read_rows(store.path, "failures")
    assert len(failures) == 3  # six plans each; it fails after eight
    assert all("asked again" in row["message"] for row in failures)
