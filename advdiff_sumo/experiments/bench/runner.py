"""A bench from its request to its table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from advdiff_sumo.core.wording import counted
from advdiff_sumo.data.run_tables import SWEEP_SETTINGS
from advdiff_sumo.experiments.bench.adversarial import ATTACKED, adversarial_table, plan_adversarial
from advdiff_sumo.experiments.bench.bench_config import BenchName, Folder, Request
from advdiff_sumo.experiments.bench.bench_rows import asked_of
from advdiff_sumo.experiments.bench.cells import BenchCells, run_cells
from advdiff_sumo.experiments.bench.defect_cells import asked_of_defects, plan_defects
from advdiff_sumo.experiments.bench.defect_score import defects_of
from advdiff_sumo.experiments.bench.episode_results import Gathered, gather, gather_rows
from advdiff_sumo.experiments.bench.fewshot import asked_of_fewshot, fewshot_table, plan_fewshot
from advdiff_sumo.experiments.bench.forecast import forecast
from advdiff_sumo.experiments.bench.natural_traffic import check_traffic, run_traffic
from advdiff_sumo.experiments.bench.reporter import ProgressReporter, Silent
from advdiff_sumo.experiments.bench.scene_list import DEFECTS_HORIZON_S
from advdiff_sumo.experiments.bench.table import Table
from advdiff_sumo.experiments.bench.table_cache import save
from advdiff_sumo.experiments.bench.transfer import asked_of_transfer, plan_transfer, transfer_table
from advdiff_sumo.sweep.sweep_runner import RemainingJobs
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import WorkerLimits

#: What a bench asks for where the user does not say; together within three hours on two cores.
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
        plan: makes warm-ups where there are any, and returns the cells.
        table: of what was gathered.
        traced: what is looked at of the background: nothing, its motion, or likelihoods and solutions, too.
    """

    plan: Callable[[Folder, int, WorkerLimits, ProgressReporter], BenchCells]
    table: Callable[[Gathered, BenchCells, Folder], Table]
    traced: Literal["no", "motion", "all"] = "no"


_CLOSED_LOOP: Mapping[BenchName, ClosedLoop] = {
    "adversarial": ClosedLoop(
        lambda folder, _workers, _limits, teller: plan_adversarial(folder, teller),
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
    "defects": ClosedLoop(lambda folder, _workers, _limits, teller: plan_defects(folder, teller), defects_of),
}


def check_request(request: Request) -> None:
    """Look at what is asked before anything is made.

    Raises:
        InputError: it cannot be met.
    """
    if request.bench == "traffic":
        check_traffic(request, Silent())
    elif request.bench == "adversarial":
        asked_of(request, Silent(), ATTACKED)
    elif request.bench == "transfer":
        asked_of_transfer(request, Silent())
    elif request.bench == "defects":
        asked_of_defects(request, Silent())
    else:
        asked_of_fewshot(request)


def run_bench(folder: Folder, workers: int, limits: WorkerLimits, teller: ProgressReporter) -> Table:
    """Run what the folder lacks and write its table in every form.

    Raises:
        InputError: the request cannot be met.
        FileError: results cannot be stored.
        EpisodeFailure: a warm-up comes to nothing.
    """
    bench = folder.request.bench
    if bench == "traffic":
        table = run_traffic(folder, workers, teller)
    else:
        closed_loop = _CLOSED_LOOP[bench]
        cells = closed_loop.plan(folder, workers, limits, teller)
        _foretell(cells, folder, workers, limits, teller)
        store = run_cells(cells, folder.sweep, workers, limits, teller)
        table = closed_loop.table(
            _gathered(closed_loop, cells, store, folder, workers, teller), cells, folder
        )
    save(folder, table)
    return table


def _gathered(
    bench: ClosedLoop, cells: BenchCells, store: Store, folder: Folder, workers: int, teller: ProgressReporter
) -> Gathered:
    if bench.traced == "no":
        return gather_rows(cells, store)
    return gather(cells, store, folder.traces, workers, teller, judged=bench.traced == "all")


def _foretell(
    cells: BenchCells, folder: Folder, workers: int, limits: WorkerLimits, teller: ProgressReporter
) -> None:
    """Say how many episodes there are, and how long those that are left will take."""
    store = Store(folder.sweep) if (folder.sweep / SWEEP_SETTINGS).exists() else None
    todo = RemainingJobs.of(cells.plan, store)
    teller.say(
        f"{counted(len(cells.plan.jobs), 'episode')} in {counted(len(cells.cells), 'cell')}; {len(todo.jobs)} to do"
    )
    expected = forecast(cells, todo.jobs, folder.request.horizon_s, limits)
    if expected is not None:
        each = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in expected.by_background.items())
        minutes = expected.total_s(workers) / 60.0
        teller.say(
            f"about {minutes:.0f} min on {counted(workers, 'worker')} with a core each; "
            f"an episode of {each} (measured now)"
        )
