"""Lead a sweep: submit tasks, store results, retry, and record failures."""

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
from advdiff_sumo.sweep.stored_episode import StoredEpisode, with_output
from advdiff_sumo.sweep.sweep_files import DiskFullError
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import Batch, EpisodeTask, Failed, Outcome, SceneTask, Task
from advdiff_sumo.sweep.work import NO_ROOM

#: Kinds of failure that may be due to earlier tasks of the worker, so that the task is retried.
_RETRIED_KINDS = {"worker_died", "simulator_crashed", "planner_crashed"}

_log = logging.getLogger(__name__)

EpisodeListener: TypeAlias = Callable[[Mapping[str, Any] | None, Failed | None], None]


@dataclass
class Scheduler:
    """The state of a running sweep.

    Attributes:
        plan: the episodes.
        store: receives the results.
        executor: runs the tasks.
        retries: number of further attempts if the worker of a task dies.
        on_episode: called with every stored episode: its row, and its failure if it failed.
        on_output: called with what planners and policies printed.
        refuses: whether unusable seed scenes or options raise instead of being recorded.
    """

    plan: SweepPlan
    store: Store
    executor: Executor
    retries: int
    on_episode: EpisodeListener
    on_output: Callable[[str], None] = lambda _: None
    refuses: bool = False
    _without_scene: dict[str, deque[Job]] = field(default_factory=dict)  # by batch
    _batches_to_make: deque[Batch] = field(default_factory=deque)
    _ready: deque[Job] = field(default_factory=deque)  # their seed scenes are stored
    _beyond_log: deque[tuple[Job, int]] = field(default_factory=deque)  # with the log's number of scenes
    _jobs: dict[str, Job] = field(default_factory=dict)
    _running: dict[str, Task] = field(default_factory=dict)
    _attempts: dict[str, int] = field(default_factory=dict)
    _net_digests: dict[str, str] = field(default_factory=dict)
    _first_failures: dict[str, Failed] = field(default_factory=dict)  # of episodes that are driven again

    def run(self, jobs: Iterable[Job]) -> None:
        """Run *jobs*.

        Raises:
            FileError: results cannot be stored; what was computed before is stored, also if the disk is full.
            InputError: ``refuses`` is set, and seed scenes or options are unusable.
        """
        for job in jobs:
            self._jobs[job.key] = job
            if job.batch not in self._without_scene:
                self._without_scene[job.batch] = deque()
                self._batches_to_make.append(self.plan.batches[job.batch])
            self._without_scene[job.batch].append(job)
        try:
            while self._fill():
                self._record_beyond_log()
                self._handle(self.executor.wait())
            self._record_beyond_log()
        except DiskFullError:
            raise self._disk_full(self._save_running()) from None

    # --- submit ------------------------------------------------------------------------------------------

    def _fill(self) -> bool:
        """Submit tasks to all free slots; return whether any task is running."""
        while len(self._running) < self.executor.slots:
            task = self._next_task()
            if task is None:
                break
            self._submit(task)
        return bool(self._running)

    def _submit(self, task: Task) -> None:
        """Submit *task* and count the attempt."""
        self._running[task.key] = task
        self._attempts[task.key] = self._attempts.get(task.key, 0) + 1
        self.executor.submit(task)

    def _next_task(self) -> Task | None:
        """Return the next task: a batch of seed scenes while fewer episodes than slots are ready, else an episode."""
        while self._batches_to_make and len(self._ready) < self.executor.slots:
            batch = self._batches_to_make.popleft()
            if not self.store.has_scenes(batch.key, batch.scenes):
                return self._scene_task(batch)
            self._release(batch)
        while self._ready:
            job = self._ready.popleft()
            scenes = self.store.read_scenes(job.batch)
            if scenes is None:  # the file was damaged after it was written
                self._without_scene.setdefault(job.batch, deque()).append(job)
                if job.batch in self._running:
                    continue
                return self._scene_task(self.plan.batches[job.batch])
            if job.scene_index < len(scenes):
                options, scene = self.plan.options(job), scenes[job.scene_index]
                return EpisodeTask(job.key, options, job.number, scene, self._net(options.net))
            self._beyond_log.append((job, len(scenes)))
        return None

    def _scene_task(self, batch: Batch) -> SceneTask:
        return SceneTask(**vars(batch), net_digest=self._net(batch.options.net))

    def _net(self, net: str) -> str:
        """Return the digest of the files of *net*."""
        if net not in self._net_digests:
            self._net_digests[net] = file_digest(*net_files(net))
        return self._net_digests[net]

    # --- results -----------------------------------------------------------------------------------------

    def _handle(self, outcome: Outcome) -> None:
        """Store or retry one outcome, and submit further tasks."""
        task = self._running.pop(outcome.key)
        attempts = self._attempts[task.key]
        if outcome.failed is not None and outcome.failed.kind == NO_ROOM:
            self._save_running()
            raise FileError(
                self.store.path, outcome.failed.message, "free some space and go on with --resume"
            )
        if outcome.failed is not None and outcome.failed.kind in _RETRIED_KINDS and attempts <= self.retries:
            self._submit(task)
            return
        if outcome.output:
            self.on_output(outcome.output)
        outcome = outcome.tried(attempts)
        if isinstance(task, EpisodeTask) and self._driven_again(task, outcome):
            return
        self._fill()  # before writing, so that no worker waits for the disk
        if isinstance(task, EpisodeTask):
            self._record(self._jobs[task.key], outcome)
        elif outcome.failed is None:
            self.store.write_scenes(task.key, outcome.product, self.plan.batches[task.key].scenes)
            self._release(self.plan.batches[task.key])
        elif isinstance(task, SceneTask):
            self._record_without_scene(task, outcome.failed)

    def _driven_again(self, task: EpisodeTask, outcome: Outcome) -> bool:
        """Submit a failed episode again, to record its rows up to the failure; return whether it was submitted.

        It is driven up to the step that it had reached. After a timeout, or if it fails again, nothing is driven.
        """
        failed = outcome.failed
        if failed is None:
            return False
        self._refuse(failed)
        if failed.is_unusable or (task.ended is not None and task.ended.steps < 0):
            return False
        first = self._first_failures.setdefault(task.key, failed)
        timed_out = failed.kind == "timeout"  # it would time out again
        reached = NOT_STARTED if timed_out or task.ended is not None else outcome.steps
        ended = Ended(reached, first.kind, first.message, first.log_tail)
        self._running[task.key] = repetition = replace(task, ended=ended)
        self.executor.submit(repetition)
        return True

    def _refuse(self, failed: Failed) -> None:
        """Raise an error if the input is unusable and ``refuses`` is set."""
        if self.refuses and failed.is_unusable:
            raise SceneError(failed.message) if failed.kind == "no_scene" else InputError(failed.message)

    def _release(self, batch: Batch) -> None:
        """Make the episodes of a batch ready, as its seed scenes are stored."""
        self._ready.extend(self._without_scene.pop(batch.key, ()))

    def _record_without_scene(self, task: SceneTask, failed: Failed) -> None:
        """Record that the episodes of a batch have no seed scene."""
        self._refuse(failed)
        message = f"no seed scene: {failed.message}"
        for job in self._without_scene.pop(task.key, ()):
            failure = Failed(failed.kind, message, failed.log_tail, self._attempts[task.key])
            self._record(job, Outcome(job.key, (), failure))

    def _record_beyond_log(self) -> None:
        """Record the episodes for which a driving log has no scene."""
        while self._beyond_log:
            job, scenes = self._beyond_log.popleft()
            if self.refuses:
                continue  # a run has only as many episodes as the log has scenes
            message = f"the log has {counted(scenes, 'seed scene')}, this is number {job.scene_index + 1}"
            self._record(job, Outcome(job.key, (), Failed("no_scene", message)))

    def _record(self, job: Job, outcome: Outcome) -> None:
        """Store the outcome of an episode; a repetition is stored with the first failure."""
        first = self._first_failures.pop(job.key, None)
        if outcome.failed is not None:
            content = StoredEpisode({}, first or outcome.failed).to_bytes()
        elif first is not None:
            content = replace(StoredEpisode.from_bytes(outcome.product[0]), failed=first).to_bytes()
        else:
            content = with_output(outcome.product[0], outcome.output)
        try:
            self.store.write(job.key, content)
        except DiskFullError:
            self.store.drop_ballast()
            self.store.write(job.key, content)
            raise
        row, failed = StoredEpisode.row_and_failure(content)
        _log.info("episode %s: %s", job.key, row["end"] if row else failed and failed.message)
        self.on_episode(row, failed)

    # --- the end -----------------------------------------------------------------------------------------

    def _save_running(self) -> int:
        """Wait for running episodes and store them in the reserved disk space; return how many did not fit."""
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
        """Return the error for a full disk; *lost*: finished episodes that did not fit."""
        left_to_do = sum(not self.store.has(key) for key in self._jobs)
        stored = "all that had finished is stored" if not lost else f"{lost} that had finished did not fit"
        return FileError(
            self.store.path,
            f"the disk is full with {counted(left_to_do, 'episode')} left to do; {stored}",
            "free some space and go on with --resume",
        )
