"""A sweep from its plan to its tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from advdiff_sumo.core.plug_in_source import code_digests
from advdiff_sumo.core.wording import counted
from advdiff_sumo.sim.run_episodes import versions
from advdiff_sumo.sweep.consolidate import consolidate
from advdiff_sumo.sweep.executors import Executor
from advdiff_sumo.sweep.job_plan import Job, SweepPlan
from advdiff_sumo.sweep.rounds import chosen_so_far, rounds
from advdiff_sumo.sweep.scheduler import Scheduler, Tell
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Failed

_BALLAST_BYTES_A_SLOT = 4 << 20


@dataclass(frozen=True)
class RemainingJobs:
    """What is left of a sweep.

    Attributes:
        jobs: episodes to run; of a diverse sweep those that have been chosen already.
        done: how many are there.
        total: how many there will be.
    """

    jobs: tuple[Job, ...]
    done: int
    total: int

    @staticmethod
    def of(
        plan: SweepPlan, store: Store | None, limit: int | None = None, retry_failed: bool = False
    ) -> RemainingJobs:
        """Return what of the first *limit* episodes is missing or damaged in *store*.

        Args:
            plan: the sweep.
            store: its folder; None before there is one.
            limit: consider only so many.
            retry_failed: run those again that failed.
        """
        total = plan.wanted if limit is None else min(limit, plan.wanted)
        wanted = chosen_so_far(plan, store).jobs[:total]
        jobs = tuple(job for job in wanted if store is None or not store.is_done(job.key, retry_failed))
        return RemainingJobs(jobs, len(wanted) - len(jobs), total)

    def ahead(self, plan: SweepPlan) -> Sequence[Job]:
        """Return as many episodes as are to be run, those of a diverse sweep spread over what it chooses from."""
        left = self.total - self.done
        if not plan.spec.diverse or not left:
            return self.jobs
        return [plan.jobs[k * len(plan.jobs) // left] for k in range(left)]


class EpisodeCount:
    """Counts a sweep's episodes that ended in a collision, and those that failed.

    Args:
        step: called with what it has come to, after every episode.
    """

    def __init__(self, step: Callable[[str], None]) -> None:
        self._step = step
        self._hits = self._failed = 0

    def tell(self, row: Mapping[str, Any] | None, failed: Failed | None) -> None:
        """Count one episode."""
        self._hits += bool(row and row["target_collision"])
        self._failed += failed is not None
        self._step(f"{counted(self._hits, 'collision')} · {self._failed} failed")


def settings_of(plan: SweepPlan) -> dict[str, Any]:
    """Return what ``sweep.toml`` holds."""
    return {
        "made_by": versions()
        | code_digests(name for one in plan.cells for name in (one.target, one.background)),
        "keys": plan.keys,
        "sweep": plan.spec.model_dump(mode="json", exclude_none=True),
    }


def open_store(path: Path, plan: SweepPlan, workers: int, resume: bool) -> Store:
    """Return the store of a new sweep in *path*, or of the one that is there already.

    Raises:
        InputError: the folder cannot be used for this sweep.
    """
    ballast = _BALLAST_BYTES_A_SLOT * (workers + 1)
    if resume:
        return Store.resume(path, plan.spec, settings_of(plan), ballast)
    return Store.create(path, settings_of(plan), ballast)


def run_sweep(
    plan: SweepPlan, store: Store, todo: RemainingJobs, executor: Executor, retries: int, tell: Tell
) -> int:
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
            for present, jobs in _parts(plan, store, todo):
                Scheduler(present, store, executor, retries, tell).run(jobs)
        present = chosen_so_far(plan, store)
        missing = consolidate(store, present) + plan.wanted - len(present.jobs)
    finally:
        store.drop_ballast()
    if not missing:
        store.end()
    return missing


def _parts(plan: SweepPlan, store: Store, todo: RemainingJobs) -> Iterator[tuple[SweepPlan, Sequence[Job]]]:
    """Yield what is run together: all that is left, or of a diverse sweep what was chosen, then its further rounds."""
    yield chosen_so_far(plan, store), todo.jobs
    if plan.spec.diverse:
        for present, jobs in rounds(plan, store, todo.total):
            yield present, [job for job in jobs if not store.has(job.key)]
