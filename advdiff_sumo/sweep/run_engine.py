"""A run is a sweep of one cell: the same tasks, workers and records, into a folder of its own form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.core.plug_in_source import code_digests
from advdiff_sumo.data.run_tables import RUN_SETTINGS
from advdiff_sumo.planners.planner_protocol import Planner
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sweep.executors import Executor
from advdiff_sumo.sweep.job_plan import plan_run, run_inputs
from advdiff_sumo.sweep.run_folder import RunFolder, must_have_inputs, read_settings
from advdiff_sumo.sweep.scheduler import Scheduler, Tell


def run_settings(run: Run) -> dict[str, Any]:
    """Return what ``run.toml`` holds: all that is needed to repeat the run, and a digest of its files."""
    settings = run.settings
    return {**settings, "run": {**settings["run"], **code_digests(run.names), "inputs": run_inputs(run)}}


def stored_run(folder: Path, planner: Planner | None = None) -> Run:
    """Return the run in *folder* as it was asked for.

    Args:
        folder: of a run.
        planner: in place of its target, which need not be at hand then.

    Raises:
        InputError: it holds no run, or none that can be prepared, or a file of it is no longer what it was.
    """
    settings = read_settings(folder)
    options = RunOptions.parse(settings.get("options", {}), str(folder / RUN_SETTINGS))
    run = Run.prepare(options, planner=planner)
    must_have_inputs(folder, settings, run_inputs(run), "repeat the run with this version of advdiff-sumo")
    return run


def run_into(
    run: Run,
    folder: RunFolder,
    executor: Executor,
    tell: Tell,
    hear: Callable[[str], None] = lambda _: None,
    retries: int = 1,
    retry_failed: bool = False,
) -> int:
    """Run the episodes that *folder* lacks and put its tables together, also after an interrupt.

    Args:
        run: the run.
        folder: where the results go.
        executor: who does it.
        tell: called with each finished episode: its row, and why it failed.
        hear: called with what planners and policies printed.
        retries: how often an episode whose worker died is tried again.
        retry_failed: run the episodes of *folder* again that failed.

    Returns:
        Number of episodes in the folder.

    Raises:
        InputError: no seed scene can be made, or a file cannot be written; what had finished is kept.
    """
    plan = plan_run(run)
    done = set(folder.done(retry_failed))
    finished = False
    try:
        with executor:
            conductor = Scheduler(plan, folder.store, executor, retries, tell, hear, refuses=True)
            conductor.run(job for job in plan.jobs if job.number not in done)
        finished = True
    finally:
        folder.store.drop_ballast()
        numbers = folder.done()
        if numbers:
            folder.consolidate(finished)
        else:
            folder.discard()
    if not numbers:
        raise SceneError(run.why_no_scene())
    return len(numbers)
