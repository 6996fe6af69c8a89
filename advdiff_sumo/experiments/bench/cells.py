"""Episodes of a bench: cells of a target and a background on the listed scenes, run as a sweep."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from advdiff_sumo.core.errors import InputError
from advdiff_sumo.data.run_tables import SWEEP_SETTINGS
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.scene_list import SceneList
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.job_plan import Job, SweepPlan, plan_sweep
from advdiff_sumo.sweep.spec import Case, SweepSpec
from advdiff_sumo.sweep.sweep_files import with_earlier, write_whole
from advdiff_sumo.sweep.sweep_runner import EpisodeCount, RemainingJobs, open_store, run_sweep, settings_of
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import WorkerLimits

_RETRIES = 2
#: What later options of the simulation record and no table reads.
_NOT_KEPT = {"record_plans": 0, "record_natural": False}


@dataclass(frozen=True, eq=False)
class BenchCell:
    """A target against a background; one and the same only with itself.

    Attributes:
        row: key of the table's row.
        target: as registered.
        background: as registered.
        target_options: of the target.
        background_options: of the background.
        like: cells of the same name here take as long as each other; "" for the row's.
        defect: what is planted in the target, where that is what the bench is about.
    """

    row: str
    target: str
    background: str
    target_options: Mapping[str, Any] = field(default_factory=dict)
    background_options: Mapping[str, Any] = field(default_factory=dict)
    like: str = ""
    defect: str = ""


@dataclass(frozen=True)
class BenchCells:
    """A planned sweep and what its episodes are for.

    Attributes:
        plan: of the sweep.
        cells: in its order.
        scenes: that each of them starts from.
    """

    plan: SweepPlan
    cells: tuple[BenchCell, ...]
    scenes: SceneList

    def jobs(self) -> Iterator[tuple[BenchCell, Job]]:
        """Yield every episode with its cell."""
        places = len(self.scenes.counts())
        for job in self.plan.jobs:
            yield self.cells[job.cell // places], job


def plan_cells(
    cells: Sequence[BenchCell], scenes: SceneList, horizon_s: float, sim: Mapping[str, Any] | None = None
) -> BenchCells:
    """Check everything and lay out the episodes; *sim* has options of the simulation, the others are usual.

    Raises:
        InputError: a target or background cannot be made, or a net is missing.
    """
    cases = [
        Case(
            net=net,
            target=cell.target,
            target_options=dict(cell.target_options),
            background=cell.background,
            background_options=dict(cell.background_options),
            demand=scenes.demand,
            scenes=scenes.log,
            seed=seed,
            episodes=count,
            scene=scenes.strata[stratum].model_dump(mode="json") if stratum else None,
        )
        for cell in cells
        for (net, seed, stratum), count in scenes.counts().items()
    ]
    known = {name: value for name, value in _NOT_KEPT.items() if name in SimOptions.model_fields}
    spec = SweepSpec.of(
        {
            "horizon_s": horizon_s,
            "sim": {**known, **(sim or {})},
            "scene": scenes.scene.model_dump(mode="json"),
            "cases": tuple(case.model_dump(mode="json", exclude_none=True) for case in cases),
        },
        "the bench",
    )
    return BenchCells(plan_sweep(spec), tuple(cells), scenes)


def open_bench_store(path: Path, plan: SweepPlan, workers: int) -> Store:
    """Return the store of the bench's sweep; one that was begun with fewer rows or scenes takes the new ones in.

    Episodes are known by their content, so those that are there already stay.

    Raises:
        FileError: the folder cannot be written.
    """
    begun = (path / SWEEP_SETTINGS).exists()
    if begun:
        settings = with_earlier(settings_of(plan), "made_by", {"made_by": made_by(path)})
        write_whole(path / SWEEP_SETTINGS, tomli_w.dumps(settings).encode())
    return open_store(path, plan, workers, begun)


def made_by(path: Path) -> Mapping[str, Any]:
    """Return the versions and digests of code that the sweep in *path* was begun with; none where it tells none."""
    try:
        return Store(path).made_by()
    except InputError:  # not begun, or damaged: it is written anew
        return {}


def run_cells(
    cells: BenchCells, path: Path, workers: int, limits: WorkerLimits, teller: ProgressReporter
) -> Store:
    """Run what is missing in *path* and return the store.

    Raises:
        FileError: results cannot be stored; what had finished is.
    """
    store = open_bench_store(path, cells.plan, workers)
    todo = RemainingJobs.of(cells.plan, store)
    teller.begin("episodes", len(todo.jobs) + todo.done, todo.done)
    counted = EpisodeCount(teller.step)
    run_sweep(cells.plan, store, todo, ProcessExecutor(workers, limits), _RETRIES, counted.tell)
    return store
