"""Run a sweep from its plan to its tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from advdiff_sumo.core.wording import counted
from advdiff_sumo.sim.run_episodes import versions
from advdiff_sumo.sweep.code_digests import code_digests
from advdiff_sumo.sweep.consolidate import consolidate
from advdiff_sumo.sweep.executors import Executor
from advdiff_sumo.sweep.job_plan import Job, SweepPlan
from advdiff_sumo.sweep.rounds import chosen_so_far, rounds
from advdiff_sumo.sweep.scheduler import EpisodeListener, Scheduler
from advdiff_sumo.sweep.sole_writer import sole_writer
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Failed

_BALLAST_BYTES_A_SLOT = 4 << 20  # disk space reserved for each running episode


@dataclass(frozen=True)
class RemainingJobs:
    """The episodes that a sweep still lacks.

    Attributes:
        jobs: episodes to run; in a diverse sweep, those already chosen.
        done: number of finished episodes.
        total: number of episodes when the sweep is complete.
    """

    jobs: tuple[Job, ...]
    done: int
    total: int

    @staticmethod
    def of(
        plan: SweepPlan, store: Store | None, limit: int | None = None, retry_failed: bool = False
    ) -> RemainingJobs:
        """Return which of the first *limit* episodes are missing or damaged in *store*.

        Args:
            plan: the sweep.
            store: its folder; None if there is none yet.
            limit: number of episodes to consider; None for all.
            retry_failed: whether failed episodes count as missing.
        """
        total = plan.episode_count if limit is None else min(limit, plan.episode_count)
        chosen = chosen_so_far(plan, store).jobs[:total]
        jobs = tuple(job for job in chosen if store is None or not store.is_done(job.key, retry_failed))
        return RemainingJobs(jobs, len(chosen) - len(jobs), total)

    def ahead(self, plan: SweepPlan) -> Sequence[Job]:
        """Return as many episodes as are left to run; in a diverse sweep, a sample spread over all candidates."""
        count = self.total - self.done
        if not plan.spec.diverse or not count:
            return self.jobs
        return [plan.jobs[k * len(plan.jobs) // count] for k in range(count)]


class EpisodeCount:
    """Counts the episodes of a sweep that ended in a collision, and those that failed.

    Args:
        step: called with the counts as text after every episode.
    """

    def __init__(self, step: Callable[[str], None]) -> None:
        self._step = step
        self._hits = self._failed = 0

    def on_episode(self, row: Mapping[str, Any] | None, failed: Failed | None) -> None:
        """Count one episode."""
        self._hits += bool(row and row["target_collision"])
        self._failed += failed is not None
        self._step(f"{counted(self._hits, 'collision')} · {self._failed} failed")


def settings_of(plan: SweepPlan) -> dict[str, Any]:
    """Return the content of ``sweep.toml``."""
    return {
        "made_by": versions()
        | code_digests(name for cell in plan.cells for name in (cell.target, cell.background)),
        "keys": plan.keys,
        "sweep": plan.spec.model_dump(mode="json", exclude_none=True),
    }


def open_store(path: Path, plan: SweepPlan, workers: int, resume: bool) -> Store:
    """Return the store of a new sweep in *path*, or with *resume* of the one already there.

    Raises:
        InputError: the folder cannot be used for this sweep.
    """
    ballast = _BALLAST_BYTES_A_SLOT * (workers + 1)
    if resume:
        Store.open(path)
        with sole_writer(path):
            return Store.resume(path, plan.spec, settings_of(plan), ballast)
    return Store.create(path, settings_of(plan), ballast)


def run_sweep(
    plan: SweepPlan,
    store: Store,
    todo: RemainingJobs,
    executor: Executor,
    retries: int,
    on_episode: EpisodeListener,
) -> int:
    """Run the remaining episodes and write the tables; return the number of missing episodes.

    Args:
        plan: the sweep.
        store: its folder.
        todo: the remaining episodes.
        executor: runs the tasks.
        retries: number of further attempts if the worker of an episode dies.
        on_episode: called with every stored episode.

    Raises:
        FileError: results cannot be stored, or another process writes into the folder; finished episodes are kept.
    """
    with sole_writer(store.path):
        try:
            with executor:
                for present, jobs in _parts(plan, store, todo):
                    Scheduler(present, store, executor, retries, on_episode).run(jobs)
            present = chosen_so_far(plan, store)
            missing = consolidate(store, present) + plan.episode_count - len(present.jobs)
        finally:
            store.drop_ballast()
        if not missing:
            store.end()
    return missing


def _parts(plan: SweepPlan, store: Store, todo: RemainingJobs) -> Iterator[tuple[SweepPlan, Sequence[Job]]]:
    """Yield what is run together: the remaining episodes, then the further rounds of a diverse sweep."""
    yield chosen_so_far(plan, store), todo.jobs
    if plan.spec.diverse:
        for present, jobs in rounds(plan, store, todo.total):
            yield present, [job for job in jobs if not store.has(job.key)]
