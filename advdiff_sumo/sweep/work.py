"""Perform tasks in a worker, which keeps nets, planners and policies loaded between tasks."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import pyarrow as pa

from advdiff_sumo.core.errors import AdvdiffError, EpisodeFailure, NetError, SceneError, is_disk_full
from advdiff_sumo.core.plug_in_source import lacks_memory, message_of
from advdiff_sumo.core.process_end import hears_ctrl_c
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.whole_file import file_state
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.arrow_tables import table_of
from advdiff_sumo.metrics.columns import Column
from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row
from advdiff_sumo.metrics.summary import summarise
from advdiff_sumo.planners.planner_protocol import Target
from advdiff_sumo.planners.planner_registry import TARGETS
from advdiff_sumo.sim.episode import Timing
from advdiff_sumo.sim.heartbeat import Heartbeat, ProcessPhase
from advdiff_sumo.sim.plan_memo import KeptPlans, PlanMemo
from advdiff_sumo.sim.run_episodes import Run, RunOptions, policy_of, read_road, target_of
from advdiff_sumo.sim.run_store import episode_tables
from advdiff_sumo.sim.scene_file import scene_from_bytes, scene_to_bytes
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sweep.fingerprint import file_digest, files_of, net_files
from advdiff_sumo.sweep.situation import SITUATION_COLUMNS, situation
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.tasks import EpisodeTask, Failed, Outcome, SceneTask, Task
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from advdiff_sumo.traffic.policy_registry import POLICIES

WORKER_COLUMNS: Mapping[str, Column] = {
    "worker": Column("int64", "", "process number of the worker", False),
    "rss_mb": Column("float64", "MB", "memory that the worker held after the episode", False),
    "peak_mb": Column("float64", "MB", "the most that it ever held", False),
}
#: Kind of failure that ends the sweep: no disk space for SUMO's own files.
NO_ROOM = "no_room"
_KEPT_PLANS = KeptPlans()
_WITHOUT_PLANNING = {"sumo", "replay"}  # policies whose plans cost nothing


def perform(task: Task, heartbeat: Heartbeat | None = None, run: Run | None = None) -> Outcome:
    """Perform *task*; every fault that leaves the process alive is returned as a failure.

    Args:
        task: the task.
        heartbeat: receives the progress of an episode.
        run: run of the episode; None: it is prepared from the task's options.
    """
    start_s = time.perf_counter()
    heartbeat = heartbeat or Heartbeat()
    try:
        product = _product(task, heartbeat, run)
    except AdvdiffError as error:
        failed = Failed(_kind(error), str(error))
    except BaseException as error:  # any fault of a plug-in is recorded and ends nothing
        if isinstance(error, KeyboardInterrupt) and hears_ctrl_c():
            raise
        failed = failed_by(error)
    else:
        return Outcome(task.key, product, None, time.perf_counter() - start_s)
    return Outcome(task.key, (), failed, time.perf_counter() - start_s, heartbeat.steps)


def failed_by(error: BaseException) -> Failed:
    """Return the failure of a task that *error* ended."""
    kind, problem = "error", type(error).__name__
    if isinstance(error, OSError) and is_disk_full(error):
        kind = NO_ROOM
    elif lacks_memory(error):
        kind, problem = "out_of_memory", "the worker ran out of memory"
    return Failed(kind, f"{problem}{message_of(error)}", "".join(traceback.format_exception(error)))


def _product(task: Task, heartbeat: Heartbeat, run: Run | None) -> tuple[bytes, ...]:
    """Return the product of *task*: seed scenes, an episode, or what the function returned."""
    if isinstance(task, SceneTask):
        return _scenes(task)
    if isinstance(task, EpisodeTask):
        return (_episode(task, heartbeat, run),)
    return (task.call(),)


def run_of(options: RunOptions, net_digest: str, heartbeat: Heartbeat | None = None) -> Run:
    """Return the run of *options*; net, target and policy come from this process's caches if possible.

    Args:
        options: options of the run.
        net_digest: digest of its net.
        heartbeat: told while target and policy are made.
    """
    heartbeat = heartbeat or Heartbeat()
    road = _road(options.net, net_digest)
    names = options.target, options.background
    with heartbeat.during(ProcessPhase.MAKING_TARGET):
        target = _target(names[0], _CacheKey(options, options.target_options))
    with heartbeat.during(ProcessPhase.MAKING_BACKGROUND):
        policy = _policy(names[1], _CacheKey(options, options.background_options))
    return Run(options, road, target, policy, names)


def _plain_run(options: RunOptions, net_digest: str) -> Run:
    """Return the run of *options* with SUMO's drivers, for tasks that need neither target nor policy."""
    plain = options.model_copy(update={"target": "IDM", "target_options": {}})
    road, policy = _road(options.net, net_digest), _policy("sumo", _CacheKey(plain, {}))
    return Run(plain, road, target_of(plain), policy, ("IDM", "sumo"))


def stored_form(run: Run, record: EpisodeRecord, timing: Timing) -> StoredEpisode:
    """Return the stored form of an episode of *run*."""
    metrics = summarise(record, run.road)
    row = episode_row(record, run.road, metrics)
    tables = episode_tables(record, row, collision_rows(record, run.road, metrics), timing)
    episodes = _with_columns(tables["episodes"], [situation(record, row, run.road)], SITUATION_COLUMNS)
    failure = record.failure
    failed = None if failure is None else Failed(failure.kind, failure.message, failure.trace)
    timing_table = _with_columns(
        tables["timing"], [{"worker": os.getpid(), "rss_mb": rss_mb(), "peak_mb": peak_mb()}], WORKER_COLUMNS
    )
    return StoredEpisode({**tables, "episodes": episodes, "timing": timing_table}, failed)


def _with_columns(table: pa.Table, rows: list[dict[str, Any]], columns: Mapping[str, Column]) -> pa.Table:
    """Return *table* with *columns*, whose values are in *rows*."""
    added = table_of(rows, columns)
    for name in added.column_names:
        table = table.append_column(added.schema.field(name), added[name])
    return table


def _scenes(task: SceneTask) -> tuple[bytes, ...]:
    """Return the seed scenes of a batch as bytes."""
    run = _plain_run(task.options, task.net_digest)
    return tuple(scene_to_bytes(scene) for scene in run.scene_batch(task.number, task.scenes))


def _episode(task: EpisodeTask, heartbeat: Heartbeat, run: Run | None) -> bytes:
    """Return the stored form of one episode as bytes."""
    unstarted = task.ended is not None and task.ended.steps < 0  # nothing of it is driven again
    if run is None and unstarted:
        run = _plain_run(task.options, task.net_digest)
    run = run or run_of(task.options, task.net_digest, heartbeat)
    scene: SeedScene = scene_from_bytes(task.scene, run.road.path)
    episode = replace(run.episode(task.number, scene), heartbeat=heartbeat, memo=_memo_of(task))
    record, timing = episode.run(task.ended)
    return stored_form(run, record, timing).to_bytes()


def _memo_of(task: EpisodeTask) -> PlanMemo | None:
    """Return the store for plans of policies that this process has already computed.

    None if a user's code, which may keep state between calls, takes part, or if plans cost nothing.
    """
    name, options = task.options.background, task.options.background_options
    surrogate = str(options.get("surrogate", "lane_graph"))
    policies = set(POLICIES.builtins) - _WITHOUT_PLANNING
    if not TARGETS.is_builtin(surrogate) or POLICIES.canonical(name) not in policies:
        return None
    key = (task.net_digest, name, repr(sorted(options.items())), _states_of(options))
    return PlanMemo(key, _KEPT_PLANS)


def _kind(error: AdvdiffError) -> str:
    """Return the kind of failure for *error*."""
    if isinstance(error, EpisodeFailure):
        return error.kind
    return "no_scene" if isinstance(error, SceneError) else "input_error"


def _states_of(options: Mapping[str, Any]) -> tuple[tuple[int, int], ...]:
    """Return values that change when a file named in *options* is rewritten."""
    return tuple(map(file_state, files_of(options)))


class _CacheKey:
    """Hashable options for caches: equal if the driver's own options, their files and the time steps are."""

    def __init__(self, options: RunOptions, own: dict[str, Any]) -> None:
        self.options, self.own = options, own
        self._text = repr((sorted(own.items()), _states_of(own), options.sim))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _CacheKey) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)


@lru_cache(maxsize=4)
def _road(net: str, digest: str) -> RoadMap:
    """Return the map of *net*, whose files must have *digest*."""
    files = net_files(net)
    if file_digest(*files) != digest:
        raise NetError(
            files[0], "is not the net that the sweep began with", "begin a new sweep for the new net"
        )
    return read_road(net)


@lru_cache(maxsize=8)
def _target(name: str, key: _CacheKey) -> Target:
    """Return the target *name*, cached by its options."""
    return target_of(key.options.model_copy(update={"target": name, "target_options": key.own}))


@lru_cache(maxsize=8)
def _policy(name: str, key: _CacheKey) -> TrafficPolicy:
    """Return the policy *name*, cached by its options."""
    return policy_of(key.options.model_copy(update={"background": name, "background_options": key.own}))


def rss_mb() -> float:
    """Return the memory that this process holds; 0 if the system does not report it."""
    return _status_mb("VmRSS:")


def peak_mb() -> float:
    """Return the largest memory that this process has held; 0 if the system does not report it."""
    return _status_mb("VmHWM:")


def data_bytes() -> int:
    """Return the private writable memory of this process; 0 if the system does not report it."""
    return int(_status_mb("VmData:") * (1 << 20))


def _status_mb(name: str) -> float:
    """Return field *name* of ``/proc/self/status``."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024.0 for line in lines if line.startswith(name)), 0.0)
