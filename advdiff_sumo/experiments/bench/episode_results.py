"""Episodes of a bench's sweep with their traces, which workers compute once and the folder keeps."""

from __future__ import annotations

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
        trace: of its background; ``UNTRACED`` where nobody asks for it.
        plan_s: median time of a plan of the background; None where it plans nothing.
        cpu_s: processor time of the episode; None where it was not measured.
    """

    scene: str
    row: Mapping[str, Any]
    trace: BackgroundTrace
    plan_s: float | None
    cpu_s: float | None = None


@dataclass
class Gathered:
    """What a sweep came to.

    Attributes:
        finished: episodes of each cell, in the order of the scenes.
        failed: how many each cell lost, by what kind of failure.
    """

    finished: dict[BenchCell, list[EpisodeResult]] = field(default_factory=dict)
    failed: dict[BenchCell, dict[str, int]] = field(default_factory=dict)


def gather(
    cells: BenchCells, store: Store, cache: Path, workers: int, teller: ProgressReporter, judged: bool = True
) -> Gathered:
    """Return all finished episodes of *cells*; their traces are made where *cache* lacks them.

    Args:
        cells: what was asked for.
        store: of their sweep.
        cache: folder of traces.
        workers: processes.
        teller: hears how far it is.
        judged: traces are to have likelihoods and solutions, which is what takes long.
    """
    cache.mkdir(parents=True, exist_ok=True)
    jobs = list(cells.jobs())
    lacking = {
        job.key: cells.plan.options(job).net for _, job in jobs if read_checked(cache / job.key) is None
    }
    teller.begin("what the background did", len(jobs), len(jobs) - len(lacking))
    tasks = {key: (trace_of, store.path, key, net, judged) for key, net in lacking.items()}
    for key, content in in_processes(tasks, workers):
        write_checked(cache / key, content)
        teller.step()
    gathered = Gathered()
    for cell, job in jobs:
        content = read_checked(cache / job.key)
        _take(gathered, cell, job, store, BackgroundTrace.from_bytes(content) if content else None)
    return gathered


def gather_rows(cells: BenchCells, store: Store) -> Gathered:
    """Return all finished episodes of *cells* without traces."""
    gathered = Gathered()
    for cell, job in cells.jobs():
        _take(gathered, cell, job, store, UNTRACED)
    return gathered


def _take(gathered: Gathered, cell: BenchCell, job: Job, store: Store, trace: BackgroundTrace | None) -> None:
    results, failed = gathered.finished.setdefault(cell, []), gathered.failed.setdefault(cell, {})
    part = store.read(job.key)
    if part is None:
        return
    if part.failed is not None:
        failed[part.failed.kind] = failed.get(part.failed.kind, 0) + 1
    if trace is None or "episodes" not in part.tables:
        return
    (row,) = part.tables["episodes"].to_pylist()
    (timing,) = part.tables["timing"].to_pylist()
    if is_failure(row):
        return
    plan_s, cpu_s = timing["background_plan_p50_s"], timing.get("cpu_s")
    results.append(EpisodeResult(job.scene_key, row, trace, plan_s, cpu_s))


def failures_told(gathered: Gathered, names: Iterable[BenchCell]) -> str:
    """Return a sentence on failed episodes; empty where there are none."""
    parts = []
    for cell in names:
        for kind, count in sorted(gathered.failed.get(cell, {}).items()):
            parts.append(f"{count} of {cell.background} against {cell.target} ({kind})")
    return f"Episodes that failed and do not count: {'; '.join(parts)}." if parts else ""
