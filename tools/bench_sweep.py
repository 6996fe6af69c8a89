"""Memory and speed of a sweep's workers: bench_sweep.py [--episodes 2000] [--alone 400] [--background replay]."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.sweep.consolidate import read_rows
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.plan import Plan, plan_sweep
from advdiff_sumo.sweep.run import Todo, open_store, run_sweep
from advdiff_sumo.sweep.spec import SweepSpec
from advdiff_sumo.sweep.tasks import Limits

WARM = 50


def sweep_of(episodes: int, background: str) -> Plan:
    """Return a plan of short episodes: two targets from the same seed scenes of the shipped downtown."""
    values = {
        "episodes": episodes // 2,
        "horizon_s": 3.0,
        "scene": {"warmup_s": 20.0, "scenes_per_warmup": 10, "spacing_s": 5.0},
        "grid": {"targets": ["IDM", "lane_graph"], "backgrounds": [background]},
    }
    return plan_sweep(SweepSpec.of(values, "bench"))


def timed(plan: Plan, workers: int, folder: Path) -> tuple[float, list[dict[str, Any]]]:
    """Run *plan*; return episodes a second, counted from the first one that finished, and the timing rows."""
    folder.mkdir(parents=True)
    (folder / "logs").mkdir()
    limits = Limits(600.0, 8000, tasks=10**9, recycle_share=1.0, logs=folder / "logs")
    store = open_store(folder / "sweep", plan, workers, resume=False)
    stamps: list[float] = []
    run_sweep(
        plan,
        store,
        Todo.of(plan, store),
        ProcessExecutor(workers, limits),
        2,
        lambda *_: stamps.append(time.perf_counter()),
    )
    return (len(stamps) - 1) / (stamps[-1] - stamps[0]), read_rows(store.path, "timing")


def memory(rows: list[dict[str, Any]]) -> list[str]:
    """Return a line a worker: memory after its first episodes, its slope from then on, its peak."""
    lines = []
    ordered = sorted(rows, key=lambda row: (row["worker"], row["episode"]))
    for number, (_, found) in enumerate(groupby(ordered, key=lambda row: row["worker"])):
        own = list(found)
        later = np.array([row["rss_mb"] for row in own[WARM:]])
        if len(later) < 2:
            continue
        slope = float(np.polyfit(np.arange(len(later)), later, 1)[0])
        peak = max(row["peak_mb"] for row in own)
        lines.append(
            f"worker {number}: {len(own)} episodes, {later[0]:.0f} MB after {WARM}, {later[-1]:.0f} MB at the end, "
            f"{1000 * slope:+.2f} MB in 1000 episodes, peak {peak:.0f} MB"
        )
    return lines


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--alone", type=int, default=400, help="episodes of the run on one worker")
    parser.add_argument("--background", default="replay")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        alone, _ = timed(sweep_of(given.alone, given.background), 1, Path(folder, "one"))
        both, rows = timed(sweep_of(given.episodes, given.background), 2, Path(folder, "two"))
    print(f"one worker {alone:.2f} episodes/s, two {both:.2f}: {both / alone:.2f} times")
    print("\n".join(memory(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
