"""Measure the memory and speed of workers: bench_sweep.py [--episodes 2000] [--alone N] [--background diffusion].

Short episodes are run on one worker, then on two. Printed are the memory of each worker over its episodes, and how
much faster two workers are than one. With --of, the memory of the workers of a finished sweep or bench is printed
instead. The exit code is 1 if a limit of ``BARS`` is not met.
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

#: Number of episodes after which the memory of a worker must no longer grow.
WARM = 50
HORIZON_S = 3.0
#: Limits: largest growth after that in MB per 1,000 episodes, largest peak in MB, least rate of two workers over one.
BARS = {"growth": 20.0, "peak": 1200.0, "rate": 1.8}


def sweep_of(episodes: int, background: str) -> SweepPlan:
    """Return a plan of short episodes: two targets in the same seed scenes of the shipped downtown."""
    values = {
        "episodes": episodes // 2,
        "horizon_s": HORIZON_S,
        "scene": {"warmup_s": 20.0, "scenes_per_warmup": 10, "spacing_s": 5.0},
        "grid": {"targets": ["IDM", "lane_graph"], "backgrounds": [background]},
    }
    return plan_sweep(SweepSpec.of(values, "bench"))


def timed(plan: SweepPlan, workers: int, folder: Path) -> tuple[float, list[dict[str, Any]]]:
    """Run *plan*; return the episodes per second after the first finished one, and the rows of ``timing``."""
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
        rss_mb: after each of its episodes, in order.
        peak_mb: largest value at any time.
    """

    rss_mb: FloatArray
    peak_mb: float

    @property
    def growth_mb(self) -> float | None:
        """Slope in MB per 1,000 episodes after the first ``WARM``; None if there are too few episodes."""
        later = self.rss_mb[WARM:]
        if len(later) < WARM:
            return None
        return 1000.0 * float(np.polyfit(np.arange(len(later)), later, 1)[0])

    def __str__(self) -> str:
        if self.growth_mb is None:
            growth = f"too few to tell growth after {WARM}"
        else:
            growth = f"{self.rss_mb[WARM]:.0f} MB after {WARM}, {self.growth_mb:+.1f} MB in 1000 from there"
        memory = f"{self.rss_mb[0]:.0f} MB after the first, {self.rss_mb[-1]:.0f} MB after the last"
        return f"{len(self.rss_mb)} episodes: {memory}; {growth}; peak {self.peak_mb:.0f} MB"


def workers_of(rows: list[dict[str, Any]]) -> list[Worker]:
    """Return the workers from the rows of ``timing``."""
    ordered = sorted(rows, key=lambda row: (row["worker"], row["episode"]))
    groups = (list(group) for _, group in groupby(ordered, key=lambda row: row["worker"]))
    return [
        Worker(np.array([row["rss_mb"] for row in group]), max(row["peak_mb"] for row in group))
        for group in groups
    ]


def missed(workers: list[Worker], ratio: float) -> list[str]:
    """Return a sentence for each limit of ``BARS`` that is not met."""
    growth_mb = max((w.growth_mb for w in workers if w.growth_mb is not None), default=0.0)
    is_missed = {"growth": growth_mb > BARS["growth"], "rate": ratio < BARS["rate"]}
    is_missed["peak"] = any(w.peak_mb > BARS["peak"] for w in workers)
    return [f"{name}: not within {BARS[name]:g}" for name, bad in sorted(is_missed.items()) if bad]


def main() -> int:
    """Measure and print the figures; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--alone", type=int, help="episodes of the run on one worker; a tenth by default")
    parser.add_argument("--background", default="diffusion")
    parser.add_argument("--of", type=Path, help="folder of a finished sweep, or of a bench")
    given = parser.parse_args()
    if given.of is not None:
        return print_figures(workers_of(read_rows(given.of, "timing")), [])
    episodes_alone = given.alone or max(10, given.episodes // 10)
    with tempfile.TemporaryDirectory() as folder:
        rate_of_one, _ = timed(sweep_of(episodes_alone, given.background), 1, Path(folder, "one"))
        rate_of_two, rows = timed(sweep_of(given.episodes, given.background), 2, Path(folder, "two"))
    return print_figures(workers_of(rows), [rate_of_one, rate_of_two])


def print_figures(workers: list[Worker], rates: list[float]) -> int:
    """Print the figures, and return the exit code.

    Args:
        workers: their memory.
        rates: episodes per second of one worker and of two; empty: not measured.
    """
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
