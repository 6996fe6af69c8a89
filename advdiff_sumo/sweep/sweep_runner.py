"""A sweep from its plan to its tables."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from advdiff_sumo.sim.run_episodes import versions
from advdiff_sumo.sweep.consolidate import consolidate
from advdiff_sumo.sweep.executors import Executor
from advdiff_sumo.sweep.job_plan import Job, Plan
from advdiff_sumo.sweep.scheduler import Conductor, Tell
from advdiff_sumo.sweep.sweep_store import Store

_BALLAST_BYTES_A_SLOT = 4 << 20


@dataclass(frozen=True)
class Todo:
    """What is left of a sweep.

    Attributes:
        jobs: episodes to run.
        done: how many are there.
    """

    jobs: tuple[Job, ...]
    done: int

    @staticmethod
    def of(plan: Plan, store: Store | None, limit: int | None = None, retry_failed: bool = False) -> Todo:
        """Return what of the first *limit* episodes is missing or damaged in *store*.

        Args:
            plan: the sweep.
            store: its folder; None before there is one.
            limit: consider only so many.
            retry_failed: run those again that failed.
        """
        wanted = plan.jobs[:limit]
        jobs = tuple(job for job in wanted if store is None or not _is_done(store, job, retry_failed))
        return Todo(jobs, len(wanted) - len(jobs))


def settings_of(plan: Plan) -> dict[str, Any]:
    """Return what ``sweep.toml`` holds."""
    return {
        "made_by": versions(),
        "keys": plan.keys,
        "sweep": plan.spec.model_dump(mode="json", exclude_none=True),
    }


def open_store(path: Path, plan: Plan, workers: int, resume: bool) -> Store:
    """Return the store of a new sweep in *path*, or of the one that is there already.

    Raises:
        InputError: the folder cannot be used for this sweep.
    """
    ballast = _BALLAST_BYTES_A_SLOT * (workers + 1)
    if resume:
        return Store.resume(path, plan.spec, settings_of(plan), ballast)
    return Store.create(path, settings_of(plan), ballast)


def run_sweep(plan: Plan, store: Store, todo: Todo, executor: Executor, retries: int, tell: Tell) -> int:
    """Run what is left and put the tables together; return how many episodes are missing.

    Args:
        plan: the sweep.
        store: its folder.
        todo: what is left.
        executor: who does it.
        retries: how often an episode whose worker died is tried again.
        tell: called with every episode that was stored.

    Raises:
        FileError: results cannot be stored; what had finished is.
    """
    try:
        with executor:
            Conductor(plan, store, executor, retries, tell).run(todo.jobs)
        missing = consolidate(store, plan)
    finally:
        store.drop_ballast()
    if not missing:
        store.end()
    return missing


def _is_done(store: Store, job: Job, retry_failed: bool) -> bool:
    if not retry_failed:
        return store.has(job.key)
    part = store.read(job.key)
    return part is not None and part.failed is None
