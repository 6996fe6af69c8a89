"""Execute a run as a sweep of one cell: same tasks, workers and records, but its own form of folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.data.run_tables import RUN_SETTINGS
from advdiff_sumo.planners.planner_protocol import Planner
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.sweep.code_digests import code_digests
from advdiff_sumo.sweep.executors import Executor
from advdiff_sumo.sweep.job_plan import plan_run, run_inputs
from advdiff_sumo.sweep.run_folder import RunFolder, must_have_inputs, read_settings
from advdiff_sumo.sweep.scheduler import EpisodeListener, Scheduler


def run_settings(run: Run) -> dict[str, Any]:
    """Return the content of ``run.toml``: all that is needed to repeat the run, and a digest of its inputs."""
    settings = run.settings
    return {**settings, "run": {**settings["run"], **code_digests(run.names), "inputs": run_inputs(run)}}


def stored_run(folder: Path, planner: Planner | None = None) -> Run:
    """Return the run stored in *folder*, prepared.

    Args:
        folder: folder of a run.
        planner: replaces the run's target, which then need not be available.

    Raises:
        InputError: the folder holds no run, the run cannot be prepared, or one of its input files has changed.
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
    on_episode: EpisodeListener,
    on_output: Callable[[str], None] = lambda _: None,
    retries: int = 1,
    retry_failed: bool = False,
) -> int:
    """Run the episodes that *folder* lacks and write its tables, also after an interrupt.

    Args:
        run: the run.
        folder: folder for the results.
        executor: runs the tasks.
        on_episode: called with each finished episode: its row, and its failure if it failed.
        on_output: called with what planners and policies printed.
        retries: number of further attempts if the worker of an episode dies.
        retry_failed: also run the failed episodes of *folder* again.

    Returns:
        Number of episodes in the folder.

    Raises:
        InputError: no seed scene can be made, or a file cannot be written; finished episodes are kept.
    """
    plan = plan_run(run)
    done = set(folder.done(retry_failed))
    finished = False
    try:
        with executor:
            scheduler = Scheduler(plan, folder.store, executor, retries, on_episode, on_output, refuses=True)
            scheduler.run(job for job in plan.jobs if job.number not in done)
        finished = True
    finally:
        folder.store.drop_ballast()
        stored = folder.done()
        if stored:
            folder.consolidate(finished)
        else:
            folder.discard()
    if not stored:
        raise SceneError(run.why_no_scene())
    return len(stored)
