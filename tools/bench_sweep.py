"""Memory and speed of a sweep's workers: bench_sweep.py [--episodes 2000] [--alone N] [--background diffusion].

Short episodes on one worker, then on two. Figures: memory of each worker over its episodes, and by how much two are
faster than one. With --of, the memory of the workers of a finished sweep or bench instead. The exit code is 1 where a
bar of ``BARS`` is missed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.sweep.consolidate import read_rows
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.job_plan import SweepPlan, plan_sweep
from advdiff_sumo.sweep.spec import SweepSpec
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep
from advdiff_sumo.sweep.tasks import WorkerLimits

#: Episodes of a worker after which its memory may grow no more.
WARM = 50
HORIZON_S = 3.0
#: Slope after that in MB in 1,000 episodes, peak in MB, and rate of two workers over that of one.
BARS = {"growth": 20.0, "peak": 1200.0, "rate": 1.8}


def sweep_of(episodes: int, background: str) -> SweepPlan:
    """Return a plan of short episodes: two targets from the same seed scenes of the shipped downtown."""
    values = {
        "episodes": episodes // 2,
        "horizon_s": HORIZON_S,
        "scene": {"warmup_s": 20.0, "scenes_per_warmup": 10, "spacing_s": 5.0},
        "grid": {"targets": ["IDM", "lane_graph"], "backgrounds": [background]},
    }
    return plan_sweep(SweepSpec.of(values, "bench"))


def timed(plan: SweepPlan, workers: int, folder: Path) -> tuple[float, list[dict[str, Any]]]:
    """Run *plan*; return episodes a second, counted from the first one that finished, and the timing rows."""
    folder.mkdir(parents=True)
    (folder / "logs").mkdir()
    limits = WorkerLimits(600.0, 8000, tasks=10**9, recycle_share=1.0, logs=folder / "logs")
    store = open_store(folder / "sweep", plan, workers, resume=False)
    stamps: list[float] = []
    run_sweep(
        plan,
        store,
        RemainingJobs.of(plan, store),
        ProcessExecutor(workers, limits),
        2,
        lambda *_: stamps.append(time.perf_counter()),
    )
    return (len(stamps) - 1) / (stamps[-1] - stamps[0]), read_rows(store.path, "timing")


@dataclass(frozen=True)
class Worker:
    """Memory of one worker.

    Attributes:
        rss_mb: after each of its episodes, in their order.
        peak_mb: the most that it ever held.
    """

    rss_mb: FloatArray
    peak_mb: float

    @property
    def growth_mb(self) -> float | None:
        """Slope in MB in 1,000 episodes after the first ``WARM``; None where it did too few to tell."""
        later = self.rss_mb[WARM:]
        if len(later) < WARM:
            return None
        return 1000.0 * float(np.polyfit(np.arange(len(later)), later, 1)[0])

    def __str__(self) -> str:
        if self.growth_mb is None:
            grew = f"too few to tell growth after {WARM}"
        else:
            grew = f"{self.rss_mb[WARM]:.0f} MB after {WARM}, {self.growth_mb:+.1f} MB in 1000 from there"
        last = f"{self.rss_mb[0]:.0f} MB after the first, {self.rss_mb[-1]:.0f} MB after the last"
        return f"{len(self.rss_mb)} episodes: {last}; {grew}; peak {self.peak_mb:.0f} MB"


def workers_of(rows: list[dict[str, Any]]) -> list[Worker]:
    """Return the workers behind the rows of ``timing``."""
    ordered = sorted(rows, key=lambda row: (row["worker"], row["episode"]))
    grouped = (list(group) for _, group in groupby(ordered, key=lambda row: row["worker"]))
    return [
        Worker(np.array([row["rss_mb"] for row in own]), max(row["peak_mb"] for row in own))
        for own in grouped
    ]


def missed(workers: list[Worker], ratio: float) -> list[str]:
    """Return which of ``BARS`` are missed."""
    grown = max((w.growth_mb for w in workers if w.growth_mb is not None), default=0.0)
    misses = {"growth": grown > BARS["growth"], "rate": ratio < BARS["rate"]}
    misses["peak"] = any(w.peak_mb > BARS["peak"] for w in workers)
    return [f"{name}: not within {BARS[name]:g}" for name, bad in sorted(misses.items()) if bad]


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--alone", type=int, help="episodes of the run on one worker; a tenth by default")
    parser.add_argument("--background", default="diffusion")
    parser.add_argument("--of", type=Path, help="folder of a finished sweep, or of a bench")
    given = parser.parse_args()
    if given.of is not None:
        return told(workers_of(read_rows(given.of, "timing")), [])
    few = given.alone or max(10, given.episodes // 10)
    with tempfile.TemporaryDirectory() as folder:
        alone, _ = timed(sweep_of(few, given.background), 1, Path(folder, "one"))
        both, rows = timed(sweep_of(given.episodes, given.background), 2, Path(folder, "two"))
    return told(workers_of(rows), [alone, both])


def told(workers: list[Worker], rates: list[float]) -> int:
    """Print the figures; returns the exit code. *rates*: episodes a second of one worker and of two, where measured."""
    ratio = rates[1] / rates[0] if rates else BARS["rate"]
    if rates:
        print(f"one worker {rates[0]:.3f} episodes/s, two {rates[1]:.3f}: {ratio:.2f} times")
    for number, worker in enumerate(workers):
        print(f"worker {number}: {worker}")
    problems = missed(workers, ratio)
    print("\n".join(problems) or "all bars are met")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
