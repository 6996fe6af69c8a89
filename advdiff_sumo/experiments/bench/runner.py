"""Runs a bench, from its request to its table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from advdiff_sumo.core.wording import counted
from advdiff_sumo.data.run_tables import SWEEP_SETTINGS
from advdiff_sumo.experiments.bench.adversarial import ATTACKED, adversarial_table, plan_adversarial
from advdiff_sumo.experiments.bench.bench_config import BenchName, Folder, Request
from advdiff_sumo.experiments.bench.bench_rows import resolve_request
from advdiff_sumo.experiments.bench.cells import BenchCells, run_cells
from advdiff_sumo.experiments.bench.defect_cells import plan_defects, resolve_defects_request
from advdiff_sumo.experiments.bench.defect_score import defects_of
from advdiff_sumo.experiments.bench.episode_results import Gathered, gather, gather_rows
from advdiff_sumo.experiments.bench.fewshot import fewshot_table, plan_fewshot, resolve_fewshot_request
from advdiff_sumo.experiments.bench.forecast import forecast
from advdiff_sumo.experiments.bench.natural_traffic import check_traffic, run_traffic
from advdiff_sumo.experiments.bench.reporter import ProgressReporter, Silent
from advdiff_sumo.experiments.bench.scene_list import DEFECTS_HORIZON_S
from advdiff_sumo.experiments.bench.table import Table
from advdiff_sumo.experiments.bench.table_cache import mark_unfinished, save
from advdiff_sumo.experiments.bench.transfer import plan_transfer, resolve_transfer_request, transfer_table
from advdiff_sumo.sweep.sweep_runner import RemainingJobs
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import WorkerLimits

#: Default options of each bench; docs/benches.md says how long they take.
DEFAULTS: Mapping[BenchName, Mapping[str, Any]] = {
    "traffic": {"scenes": "300", "seeds": 1},
    "adversarial": {"scenes": "60"},
    "transfer": {"scenes": "8"},
    "fewshot": {"scenes": "30", "seeds": 5},
    "defects": {"scenes": "60", "horizon_s": DEFECTS_HORIZON_S},
}


@dataclass(frozen=True)
class ClosedLoop:
    """A bench whose figures come from episodes.

    Attributes:
        plan: runs the warm-ups, if it needs any, and returns the cells.
        table: makes the table from the episodes.
        traced: what is computed of the background: nothing, its motion, or also likelihoods and solutions.
    """

    plan: Callable[[Folder, int, WorkerLimits, ProgressReporter], BenchCells]
    table: Callable[[Gathered, BenchCells, Folder], Table]
    traced: Literal["no", "motion", "all"] = "no"


_CLOSED_LOOP: Mapping[BenchName, ClosedLoop] = {
    "adversarial": ClosedLoop(
        lambda folder, _workers, _limits, reporter: plan_adversarial(folder, reporter),
        lambda gathered, cells, folder: adversarial_table(gathered, cells.scenes, folder),
        traced="all",
    ),
    "transfer": ClosedLoop(
        plan_transfer,
        lambda gathered, cells, folder: transfer_table(gathered, cells.scenes, folder),
        traced="motion",
    ),
    "fewshot": ClosedLoop(
        plan_fewshot, lambda gathered, cells, folder: fewshot_table(gathered, cells.scenes, folder)
    ),
    "defects": ClosedLoop(
        lambda folder, _workers, _limits, reporter: plan_defects(folder, reporter), defects_of
    ),
}


def check_request(request: Request) -> None:
    """Check a request before anything is run.

    Raises:
        InputError: an option is unknown or impossible.
    """
    if request.bench == "traffic":
        check_traffic(request, Silent())
    elif request.bench == "adversarial":
        resolve_request(request, Silent(), ATTACKED)
    elif request.bench == "transfer":
        resolve_transfer_request(request, Silent())
    elif request.bench == "defects":
        resolve_defects_request(request, Silent())
    else:
        resolve_fewshot_request(request)


def run_bench(
    folder: Folder, workers: int, limits: WorkerLimits, reporter: ProgressReporter, retry_failed: bool = False
) -> Table:
    """Run the episodes that the folder lacks, and write its table in every format.

    With *retry_failed* the episodes that failed are run again.

    Raises:
        InputError: an option of the request is unknown or impossible.
        FileError: results cannot be stored.
        EpisodeFailure: a warm-up fails.
    """
    bench = folder.request.bench
    if retry_failed:
        mark_unfinished(folder)
    if bench == "traffic":
        table = run_traffic(folder, workers, reporter)
    else:
        closed_loop = _CLOSED_LOOP[bench]
        cells = closed_loop.plan(folder, workers, limits, reporter)
        remaining = _remaining(cells, folder, retry_failed)
        _report_forecast(cells, remaining, folder, workers, limits, reporter)
        for job in remaining.jobs:  # the trace of a failed episode is empty
            (folder.traces / job.key).unlink(missing_ok=True)
        store = run_cells(cells, folder.sweep, workers, limits, reporter, retry_failed)
        table = closed_loop.table(
            _gathered(closed_loop, cells, store, folder, workers, reporter), cells, folder
        )
    save(folder, table)
    return table


def _gathered(
    bench: ClosedLoop,
    cells: BenchCells,
    store: Store,
    folder: Folder,
    workers: int,
    reporter: ProgressReporter,
) -> Gathered:
    if bench.traced == "no":
        return gather_rows(cells, store)
    return gather(cells, store, folder.traces, workers, reporter, with_likelihood=bench.traced == "all")


def _remaining(cells: BenchCells, folder: Folder, retry_failed: bool) -> RemainingJobs:
    store = Store(folder.sweep) if (folder.sweep / SWEEP_SETTINGS).exists() else None
    return RemainingJobs.of(cells.plan, store, retry_failed=retry_failed)


def _report_forecast(
    cells: BenchCells,
    remaining: RemainingJobs,
    folder: Folder,
    workers: int,
    limits: WorkerLimits,
    reporter: ProgressReporter,
) -> None:
    """Report the number of episodes, and how long the remaining ones will take."""
    episodes = f"{counted(len(cells.plan.jobs), 'episode')} in {counted(len(cells.cells), 'cell')}"
    reporter.say(f"{episodes}; {len(remaining.jobs)} to do")
    expected = forecast(cells, remaining.jobs, folder.request.horizon_s, limits)
    if expected is not None:
        times = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in expected.by_background.items())
        minutes = expected.total_s(workers) / 60.0
        reporter.say(
            f"about {minutes:.0f} min on {counted(workers, 'worker')} with a core each; "
            f"an episode of {times} (measured now)"
        )
