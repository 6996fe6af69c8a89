"""Leads a sweep: hands tasks out, takes results in, tries again, records what failed."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from advdiff_sumo.core.errors import FileError, InputError, SceneError
from advdiff_sumo.core.wording import counted
from advdiff_sumo.sim.episode import Ended
from advdiff_sumo.sim.heartbeat import NOT_STARTED
from advdiff_sumo.sweep.executors import Executor
from advdiff_sumo.sweep.fingerprint import file_digest, net_files
from advdiff_sumo.sweep.job_plan import Job, SweepPlan
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_files import DiskFullError
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Batch, EpisodeTask, Failed, Outcome, SceneTask, Task
from advdiff_sumo.sweep.work import NO_ROOM

#: Failures that may say nothing about the episode but about what its worker did before: it is tried again.
_CHANCE = {"worker_died", "simulator_crashed", "planner_crashed"}

_log = logging.getLogger(__name__)

Tell: TypeAlias = Callable[[Mapping[str, Any] | None, Failed | None], None]


@dataclass
class Scheduler:
    """The state of a running sweep.

    Attributes:
        plan: what to do.
        store: where it goes.
        executor: who does it.
        retries: how often a task whose worker died is given again.
        tell: called with every episode that was stored: its row, and why it failed.
        hear: called with what planners and policies printed.
        refuses: raise where seed scenes or options cannot be used, in place of recording it.
    """

    plan: SweepPlan
    store: Store
    executor: Executor
    retries: int
    tell: Tell
    hear: Callable[[str], None] = lambda _: None
    refuses: bool = False
    _waiting: dict[str, deque[Job]] = field(default_factory=dict)
    _unmade: deque[Batch] = field(default_factory=deque)
    _ready: deque[Job] = field(default_factory=deque)
    _short: deque[tuple[Job, int]] = field(default_factory=deque)
    _jobs: dict[str, Job] = field(default_factory=dict)
    _running: dict[str, Task] = field(default_factory=dict)
    _attempts: dict[str, int] = field(default_factory=dict)
    _net_digests: dict[str, str] = field(default_factory=dict)
    _ended: dict[str, Failed] = field(default_factory=dict)

    def run(self, jobs: Iterable[Job]) -> None:
        """Do *jobs*.

        Raises:
            FileError: results cannot be stored; all that was computed until then is, disk full included.
            InputError: ``refuses``, and so.
        """
        for job in jobs:
            self._jobs[job.key] = job
            if job.batch not in self._waiting:
                self._waiting[job.batch] = deque()
                self._unmade.append(self.plan.batches[job.batch])
            self._waiting[job.batch].append(job)
        try:
            while self._fill():
                self._record_short()
                self._take(self.executor.wait())
            self._record_short()
        except DiskFullError:
            raise self._disk_full(self._save_running()) from None

    # --- out ---------------------------------------------------------------------------------------------

    def _fill(self) -> bool:
        """Give every free slot a task; return whether anything is running."""
        while len(self._running) < self.executor.slots:
            task = self._next()
            if task is None:
                break
            self._submit(task)
        return bool(self._running)

    def _submit(self, task: Task) -> None:
        self._running[task.key] = task
        self._attempts[task.key] = self._attempts.get(task.key, 0) + 1
        self.executor.submit(task)

    def _next(self) -> Task | None:
        """Return the next task: seed scenes while fewer episodes than slots are ready, else an episode."""
        while self._unmade and len(self._ready) < self.executor.slots:
            batch = self._unmade.popleft()
            if not self._has_scenes(batch):
                return self._scene_task(batch)
            self._release(batch)
        while self._ready:
            job = self._ready.popleft()
            scenes = self.store.read_scenes(job.batch)
            if scenes is None:  # damaged since it was written
                self._waiting.setdefault(job.batch, deque()).append(job)
                if job.batch in self._running:
                    continue
                return self._scene_task(self.plan.batches[job.batch])
            if job.place < len(scenes):
                options = self.plan.options(job)
                return EpisodeTask(job.key, options, job.number, scenes[job.place], self._net(options.net))
            self._short.append((job, len(scenes)))
        return None

    def _has_scenes(self, batch: Batch) -> bool:
        """Return whether the seed scenes of *batch* are stored; of a driving log they may be fewer than are wanted."""
        return self.store.has_scenes(batch.key, batch.scenes)

    def _scene_task(self, batch: Batch) -> SceneTask:
        return SceneTask(**vars(batch), net_digest=self._net(batch.options.net))

    def _net(self, net: str) -> str:
        if net not in self._net_digests:
            self._net_digests[net] = file_digest(*net_files(net))
        return self._net_digests[net]

    # --- in ----------------------------------------------------------------------------------------------

    def _take(self, outcome: Outcome) -> None:
        task = self._running.pop(outcome.key)
        attempts = self._attempts[task.key]
        if outcome.failed is not None and outcome.failed.kind == NO_ROOM:
            self._save_running()
            raise FileError(
                self.store.path, outcome.failed.message, "free some space and go on with --resume"
            )
        if outcome.failed is not None and outcome.failed.kind in _CHANCE and attempts <= self.retries:
            self._submit(task)
            return
        if outcome.said:
            self.hear(outcome.said)
        outcome = outcome.tried(attempts)
        if isinstance(task, EpisodeTask) and self._made_again(task, outcome):
            return
        self._fill()  # workers first, then the disk
        if isinstance(task, EpisodeTask):
            self._record(self._jobs[task.key], outcome)
        elif outcome.failed is None:
            self.store.write_scenes(task.key, outcome.product, self.plan.batches[task.key].scenes)
            self._release(self.plan.batches[task.key])
        elif isinstance(task, SceneTask):
            self._give_up(task, outcome.failed)

    def _made_again(self, task: EpisodeTask, outcome: Outcome) -> bool:
        """Let what happened before an episode ended its worker be made again, as far as that goes, for its rows."""
        failed = outcome.failed
        if failed is None:
            return False
        self._refuse(failed)
        if failed.is_unusable or (task.ended is not None and task.ended.steps < 0):
            return False
        first = self._ended.setdefault(task.key, failed)
        slow = failed.kind == "timeout"  # it would be too slow again
        reached = NOT_STARTED if slow or task.ended is not None else outcome.steps
        ended = Ended(reached, first.kind, first.message, first.log_tail)
        self._running[task.key] = again = replace(task, ended=ended)
        self.executor.submit(again)
        return True

    def _refuse(self, failed: Failed) -> None:
        if self.refuses and failed.is_unusable:
            raise SceneError(failed.message) if failed.kind == "no_scene" else InputError(failed.message)

    def _release(self, batch: Batch) -> None:
        self._ready.extend(self._waiting.pop(batch.key, ()))

    def _give_up(self, task: SceneTask, failed: Failed) -> None:
        """Record that the episodes of a batch have no seed scene."""
        self._refuse(failed)
        message = f"no seed scene: {failed.message}"
        for job in self._waiting.pop(task.key, ()):
            final = Failed(failed.kind, message, failed.log_tail, self._attempts[task.key])
            self._record(job, Outcome(job.key, (), final))

    def _record_short(self) -> None:
        """Record the episodes for which a driving log has no scene."""
        while self._short:
            job, scenes = self._short.popleft()
            if self.refuses:
                continue  # there are as many episodes as the log has scenes
            message = f"the log has {counted(scenes, 'seed scene')}, this is number {job.place + 1}"
            self._record(job, Outcome(job.key, (), Failed("no_scene", message)))

    def _record(self, job: Job, outcome: Outcome) -> None:
        first = self._ended.pop(job.key, None)
        if outcome.failed is not None:
            content = StoredEpisode({}, first or outcome.failed).to_bytes()
        elif first is not None:
            content = replace(StoredEpisode.from_bytes(outcome.product[0]), failed=first).to_bytes()
        else:
            content = outcome.product[0]
        try:
            self.store.write(job.key, content)
        except DiskFullError:
            self.store.drop_ballast()
            self.store.write(job.key, content)
            raise
        row, failed = StoredEpisode.glance(content)
        _log.info("episode %s: %s", job.key, row["end"] if row else failed and failed.message)
        self.tell(row, failed)

    # --- the end -----------------------------------------------------------------------------------------

    def _save_running(self) -> int:
        """Let what is running finish and store it in the room that was kept back; return how many did not fit."""
        self.store.drop_ballast()
        lost = 0
        while self._running:
            outcome = self.executor.wait()
            task = self._running.pop(outcome.key)
            if isinstance(task, EpisodeTask) and outcome.failed is None:
                try:
                    self.store.write(task.key, outcome.product[0])
                except DiskFullError:
                    lost += 1
        return lost

    def _disk_full(self, lost: int) -> FileError:
        left = sum(not self.store.has(key) for key in self._jobs)
        kept = "all that had finished is stored" if not lost else f"{lost} that had finished did not fit"
        return FileError(
            self.store.path,
            f"the disk is full with {counted(left, 'episode')} left to do; {kept}",
            "free some space and go on with --resume",
        )
