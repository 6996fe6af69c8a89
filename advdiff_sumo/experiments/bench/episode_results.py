"""Reads the episodes of a bench's sweep, with traces that workers compute once and the folder stores."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from advdiff_sumo.core.worker_pool import in_processes
from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.traces import UNTRACED, BackgroundTrace, trace_of
from advdiff_sumo.metrics.severity import is_failure
from advdiff_sumo.sweep.job_plan import Job
from advdiff_sumo.sweep.sweep_files import read_checked, write_checked
from advdiff_sumo.sweep.sweep_store import Store


@dataclass(frozen=True)
class EpisodeResult:
    """One finished episode.

    Attributes:
        scene: key of its seed scene; the same for all cells.
        row: of ``episodes``.
        trace: of its background; ``UNTRACED`` if the table does not need it.
        plan_s: median time of a plan of the background; None if it plans nothing.
        cpu_s: processor time of the episode; None if it was not measured.
    """

    scene: str
    row: Mapping[str, Any]
    trace: BackgroundTrace
    plan_s: float | None
    cpu_s: float | None = None


@dataclass
class Gathered:
    """The episodes of a sweep.

    Attributes:
        finished: of each cell, in the order of the scenes.
        failed: of each cell, number of failed episodes by kind of failure.
    """

    finished: dict[BenchCell, list[EpisodeResult]] = field(default_factory=dict)
    failed: dict[BenchCell, dict[str, int]] = field(default_factory=dict)


def gather(
    cells: BenchCells,
    store: Store,
    cache: Path,
    workers: int,
    reporter: ProgressReporter,
    with_likelihood: bool = True,
) -> Gathered:
    """Return all finished episodes of *cells*; missing traces are computed and stored in *cache*.

    Args:
        cells: of the bench.
        store: of their sweep.
        cache: folder of traces.
        workers: number of processes.
        reporter: shows the progress.
        with_likelihood: traces include likelihoods and solutions, which take long to compute.
    """
    cache.mkdir(parents=True, exist_ok=True)
    jobs = list(cells.jobs())
    missing = {
        job.key: cells.plan.options(job).net for _, job in jobs if read_checked(cache / job.key) is None
    }
    reporter.begin("what the background did", len(jobs), len(jobs) - len(missing))
    tasks = {key: (trace_of, store.path, key, net, with_likelihood) for key, net in missing.items()}
    for key, content in in_processes(tasks, workers):
        write_checked(cache / key, content)
        reporter.step()
    gathered = Gathered()
    for cell, job in jobs:
        content = read_checked(cache / job.key)
        _add_episode(gathered, cell, job, store, BackgroundTrace.from_bytes(content) if content else None)
    return gathered


def gather_rows(cells: BenchCells, store: Store) -> Gathered:
    """Return all finished episodes of *cells* without traces."""
    gathered = Gathered()
    for cell, job in cells.jobs():
        _add_episode(gathered, cell, job, store, UNTRACED)
    return gathered


def _add_episode(
    gathered: Gathered, cell: BenchCell, job: Job, store: Store, trace: BackgroundTrace | None
) -> None:
    results, failed = gathered.finished.setdefault(cell, []), gathered.failed.setdefault(cell, {})
    stored = store.read(job.key)
    if stored is None:
        return
    if stored.failed is not None:
        failed[stored.failed.kind] = failed.get(stored.failed.kind, 0) + 1
    if trace is None or "episodes" not in stored.tables:
        return
    (row,) = stored.tables["episodes"].to_pylist()
    (timing,) = stored.tables["timing"].to_pylist()
    if is_failure(row):
        return
    plan_s, cpu_s = timing["background_plan_p50_s"], timing.get("cpu_s")
    results.append(EpisodeResult(job.scene_key, row, trace, plan_s, cpu_s))


def failures_sentence(gathered: Gathered, cells: Iterable[BenchCell]) -> str:
    """Return a sentence on failed episodes; "" if there are none."""
    counts: Counter[tuple[str, str, str]] = Counter()
    for cell in cells:
        for kind, count in gathered.failed.get(cell, {}).items():
            counts[cell.background, cell.target, kind] += count
    parts = [f"{counts[key]} of {key[0]} against {key[1]} ({key[2]})" for key in sorted(counts)]
    if not parts:
        return ""
    return f"Episodes that failed and do not count: {'; '.join(parts)}; run them again with --retry-failed."
