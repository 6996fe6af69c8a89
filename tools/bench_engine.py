"""Measure the overhead of worker processes: bench_engine.py [--episodes 12] [--rounds 5] [--clock wall].

Each round runs the same episodes in three ways: in a plain loop in this process, which writes their tables; as a run;
and as a sweep of one cell on one worker. The time is that from the end of the first episode to the end of the last
one; the time up to the end of the first episode is printed separately. On a busy machine, use --clock cpu: it adds the
processor times of this process and the worker, as if they never ran at the same time. The exit code is 1 if the run or
the sweep takes longer than ``BAR`` times the plain loop.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pyarrow.parquet as pq

from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sim.run_store import episode_tables
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.job_plan import plan_run
from advdiff_sumo.sweep.run_engine import run_into, run_settings
from advdiff_sumo.sweep.run_folder import RunFolder
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep
from advdiff_sumo.sweep.tasks import WorkerLimits

#: Longest permitted time of run and sweep, as a multiple of that of the plain loop.
BAR = 1.03


Clock: TypeAlias = Callable[[], float]


def cpu_s() -> float:
    """Return the processor time in s of this process and its workers."""
    return time.process_time() + sum(_cpu_of(worker) for worker in ProcessExecutor.workers())


def _cpu_of(pid: int) -> float:
    """Return the processor time in s of the process *pid*."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


CLOCKS: dict[str, Clock] = {"wall": time.perf_counter, "cpu": cpu_s}


def plain_loop(run: Run, folder: Path, clock: Clock) -> list[float]:
    """Run the episodes in this process and write their tables; return the clock at the start and after each episode."""
    folder.mkdir()
    stamps = [clock()]
    for number, scene in enumerate(run.scene_batch(0)):
        record, timing = run.episode(number, scene).run()
        row, contacts = episode_row(record, run.road), collision_rows(record, run.road)
        for name, table in episode_tables(record, row, contacts, timing).items():
            pq.write_table(table, folder / f"{number:06d}.{name}.parquet", compression="zstd")
        stamps.append(clock())
    return stamps


def guarded_run(run: Run, folder: Path, clock: Clock) -> list[float]:
    """Run the episodes as ``advdiff-sumo run`` does; return the clock as :func:`plain_loop` does."""
    stamps = [clock()]
    run_folder = RunFolder.create(folder / "run", run_settings(run), resume=False)
    run_into(run, run_folder, ProcessExecutor(1, _limits(folder)), lambda *_: stamps.append(clock()))
    return stamps


def sweep_of_one_cell(run: Run, folder: Path, clock: Clock) -> list[float]:
    """Run the episodes as ``advdiff-sumo sweep`` does; return the clock as :func:`plain_loop` does."""
    stamps = [clock()]
    plan = plan_run(run)
    store = open_store(folder / "sweep", plan, 1, resume=False)
    executor = ProcessExecutor(1, _limits(folder))
    run_sweep(plan, store, RemainingJobs.of(plan, store), executor, 1, lambda *_: stamps.append(clock()))
    return stamps


def _limits(folder: Path) -> WorkerLimits:
    logs = folder / "logs"
    logs.mkdir(parents=True)
    return WorkerLimits(600.0, 4000, 250, 0.5, logs, 300.0)


WAYS: dict[str, Callable[[Run, Path, Clock], list[float]]] = {
    "plain loop": plain_loop,
    "run": guarded_run,
    "sweep": sweep_of_one_cell,
}


def main() -> int:
    """Measure and print the times; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--episodes", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--horizon", type=float, default=20.0)
    parser.add_argument("--target", default="lane_graph")
    parser.add_argument("--background", default="replay")
    parser.add_argument("--clock", choices=tuple(CLOCKS), default="wall", help="cpu on a busy machine")
    given = parser.parse_args()
    one_thread_for_good()
    scene = {"scenes_per_warmup": given.episodes, "warmup_s": 30.0}
    options = {name: getattr(given, name) for name in ("episodes", "target", "background")}
    run = Run.prepare(RunOptions.parse({**options, "horizon_s": given.horizon, "scene": scene}))
    duration_s: dict[str, list[float]] = {name: [] for name in WAYS}
    first_s: dict[str, list[float]] = {name: [] for name in WAYS}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(given.rounds):
            for name in sorted(WAYS, key=lambda way: (list(WAYS).index(way) + number) % len(WAYS)):
                stamps = WAYS[name](run, Path(folder, f"{name}-{number}"), CLOCKS[given.clock])
                duration_s[name].append(stamps[-1] - stamps[1])
                first_s[name].append(stamps[1] - stamps[0])
    is_too_slow = False
    for name in WAYS:
        ratio = statistics.median(
            a / b for a, b in zip(duration_s[name], duration_s["plain loop"], strict=True)
        )
        each = statistics.median(duration_s[name]) / (given.episodes - 1)
        first = statistics.median(first_s[name])
        print(f"{name}: {each:.3f} s an episode, {ratio:.3f} times the plain loop; first after {first:.1f} s")
        is_too_slow |= ratio > BAR
    print(f"not within {BAR:g}" if is_too_slow else "within the bar")
    return int(is_too_slow)


if __name__ == "__main__":
    sys.exit(main())
