"""A bench from its request to its table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from advdiff_sumo.data.run_tables import SWEEP_SETTINGS
from advdiff_sumo.experiments.bench.adversarial import ATTACKED, plan_adversarial, run_adversarial
from advdiff_sumo.experiments.bench.bench_config import BenchName, Folder, Request
from advdiff_sumo.experiments.bench.bench_rows import asked_of
from advdiff_sumo.experiments.bench.cells import BenchCells
from advdiff_sumo.experiments.bench.defect_cells import asked_of_defects, plan_defects
from advdiff_sumo.experiments.bench.defect_score import run_defects
from advdiff_sumo.experiments.bench.fewshot import asked_of_fewshot, plan_fewshot, run_fewshot
from advdiff_sumo.experiments.bench.forecast import forecast
from advdiff_sumo.experiments.bench.natural_traffic import check_traffic, run_traffic
from advdiff_sumo.experiments.bench.progress import ProgressReporter, Silent
from advdiff_sumo.experiments.bench.scene_list import DEFECTS_HORIZON_S
from advdiff_sumo.experiments.bench.table import Table
from advdiff_sumo.experiments.bench.table_cache import save
from advdiff_sumo.experiments.bench.transfer import asked_of_transfer, plan_transfer, run_transfer
from advdiff_sumo.sweep.sweep_runner import RemainingJobs
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Limits

#: What a bench asks for where the user does not say; together within three hours on two cores.
DEFAULTS: Mapping[BenchName, Mapping[str, Any]] = {
    "traffic": {"scenes": "300", "seeds": 1},
    "adversarial": {"scenes": "60"},
    "transfer": {"scenes": "8"},
    "fewshot": {"scenes": "30", "seeds": 5},
    "defects": {"scenes": "60", "horizon_s": DEFECTS_HORIZON_S},
}
_Plan = Callable[[Folder, int, ProgressReporter], BenchCells]
_Run = Callable[[Folder, BenchCells, int, Limits, ProgressReporter], Table]
_CLOSED_LOOP: Mapping[BenchName, tuple[_Plan, _Run]] = {
    "adversarial": (lambda folder, _, teller: plan_adversarial(folder, teller), run_adversarial),
    "transfer": (plan_transfer, run_transfer),
    "fewshot": (plan_fewshot, run_fewshot),
    "defects": (lambda folder, _, teller: plan_defects(folder, teller), run_defects),
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


def run_bench(folder: Folder, workers: int, limits: Limits, teller: ProgressReporter) -> Table:
    """Run what the folder lacks and write its table in every form.

    Raises:
        InputError: the request cannot be met.
        FileError: results cannot be stored.
    """
    bench = folder.request.bench
    if bench == "traffic":
        table = run_traffic(folder, workers, teller)
    else:
        plan, run = _CLOSED_LOOP[bench]
        cells = plan(folder, workers, teller)
        _foretell(cells, folder, workers, limits, teller)
        table = run(folder, cells, workers, limits, teller)
    save(folder, table)
    return table


def _foretell(
    cells: BenchCells, folder: Folder, workers: int, limits: Limits, teller: ProgressReporter
) -> None:
    """Say how many episodes there are, and how long those that are left will take."""
    store = Store(folder.sweep) if (folder.sweep / SWEEP_SETTINGS).exists() else None
    todo = RemainingJobs.of(cells.plan, store)
    teller.say(f"{len(cells.plan.jobs)} episodes in {len(cells.cells)} cells; {len(todo.jobs)} to do")
    expected = forecast(cells, todo.jobs, folder.request.horizon_s, limits)
    if expected is not None:
        each = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in expected.by_background.items())
        minutes = expected.total_s(workers) / 60.0
        teller.say(
            f"about {minutes:.0f} min on {workers} workers with a core each; an episode of {each} (measured now)"
        )
