"""Plans and runs the episodes of a bench as a sweep: cells of a target and a background, on the listed scenes."""

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
#: Options that turn off recordings which no table uses.
_RECORD_LESS = {"record_plans": 0, "record_natural": False}


@dataclass(frozen=True, eq=False)
class BenchCell:
    """A target against a background. Cells are compared by identity.

    Attributes:
        row: key of the table's row.
        target: as registered.
        background: as registered.
        target_options: of the target.
        background_options: of the background.
        like: group of cells whose episodes take equally long; "": those of the same row.
        defect: planted in the target; only of ``bench defects``.
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
    """A planned sweep and the cells of its episodes.

    Attributes:
        plan: of the sweep.
        cells: in its order.
        scenes: seed scenes of each cell.
    """

    plan: SweepPlan
    cells: tuple[BenchCell, ...]
    scenes: SceneList

    def jobs(self) -> Iterator[tuple[BenchCell, Job]]:
        """Yield every episode with its cell."""
        cases_per_cell = len(self.scenes.counts())
        for job in self.plan.jobs:
            yield self.cells[job.cell // cases_per_cell], job


def plan_cells(
    cells: Sequence[BenchCell], scenes: SceneList, horizon_s: float, sim: Mapping[str, Any] | None = None
) -> BenchCells:
    """Check the cells and plan their episodes; *sim* has options of the simulation that differ from the defaults.

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
    recording = {name: value for name, value in _RECORD_LESS.items() if name in SimOptions.model_fields}
    spec = SweepSpec.of(
        {
            "horizon_s": horizon_s,
            "sim": {**recording, **(sim or {})},
            "scene": scenes.scene.model_dump(mode="json"),
            "cases": tuple(case.model_dump(mode="json", exclude_none=True) for case in cases),
        },
        "the bench",
    )
    return BenchCells(plan_sweep(spec), tuple(cells), scenes)


def open_bench_store(path: Path, plan: SweepPlan, workers: int) -> Store:
    """Return the store of the bench's sweep; if it exists, new rows and scenes are added.

    Episodes are identified by their options, so finished ones are kept.

    Raises:
        FileError: the folder cannot be written.
    """
    is_begun = (path / SWEEP_SETTINGS).exists()
    if is_begun:
        settings = with_earlier(settings_of(plan), "made_by", {"made_by": made_by(path)})
        write_whole(path / SWEEP_SETTINGS, tomli_w.dumps(settings).encode())
    return open_store(path, plan, workers, is_begun)


def made_by(path: Path) -> Mapping[str, Any]:
    """Return the versions and digests of the code with which the sweep in *path* was begun; empty if unknown."""
    try:
        return Store(path).made_by()
    except InputError:  # not begun, or damaged: it is written again
        return {}


def run_cells(
    cells: BenchCells,
    path: Path,
    workers: int,
    limits: WorkerLimits,
    reporter: ProgressReporter,
    retry_failed: bool = False,
) -> Store:
    """Run the episodes that *path* lacks, with *retry_failed* also those that failed, and return the store.

    Raises:
        FileError: results cannot be stored; those of earlier episodes are.
    """
    store = open_bench_store(path, cells.plan, workers)
    remaining = RemainingJobs.of(cells.plan, store, retry_failed=retry_failed)
    reporter.begin("episodes", len(remaining.jobs) + remaining.done, remaining.done)
    episode_count = EpisodeCount(reporter.step)
    run_sweep(
        cells.plan, store, remaining, ProcessExecutor(workers, limits), _RETRIES, episode_count.on_episode
    )
    return store
