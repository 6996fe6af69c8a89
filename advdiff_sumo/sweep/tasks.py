"""Define tasks and outcomes: plain values that any process or machine can read."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from advdiff_sumo.sim.episode import Ended
from advdiff_sumo.sim.heartbeat import NOT_STARTED, ProcessPhase
from advdiff_sumo.sim.run_episodes import RunOptions

#: A step of SUMO, or the making of a planner, that takes longer is taken to hang. The start of SUMO with a large net,
#: and the reading of large weights, take less.
STEP_TIMEOUT_S = 300.0


@dataclass(frozen=True)
class Batch:
    """Seed scenes that are made together: those of one warm-up, or those of a driving log.

    Attributes:
        key: digest of all that they depend on.
        options: options of a run that needs them.
        number: number of the stretch of traffic; 0 for a log.
        scenes: how many are wanted; of a warm-up, those up to the last one that is needed.
    """

    key: str
    options: RunOptions
    number: int
    scenes: int


@dataclass(frozen=True)
class SceneTask(Batch):
    """A task to make the seed scenes of one batch.

    Attributes:
        net_digest: digest of the net file, so that a later change is noticed.
    """

    net_digest: str


@dataclass(frozen=True)
class EpisodeTask:
    """A task to run one episode.

    Attributes:
        key: key of the episode.
        options: options of its run.
        number: number of the episode in that run.
        scene: its seed scene, see :mod:`advdiff_sumo.sim.scene_file`.
        net_digest: digest of the net file.
        ended: how an earlier attempt ended its worker; the episode is then driven and recorded up to there.
    """

    key: str
    options: RunOptions
    number: int
    scene: bytes
    net_digest: str
    ended: Ended | None = None


@dataclass(frozen=True)
class CallTask:
    """A task to call a function that may do anything to its process.

    Attributes:
        key: key of the task.
        call: the function with its arguments; another process must be able to import both.
    """

    key: str
    call: Callable[[], bytes]


Task: TypeAlias = SceneTask | EpisodeTask | CallTask


@dataclass(frozen=True)
class Failed:
    """Why a task failed, or an episode could not be finished.

    Attributes:
        kind: one word, see ``docs/sweeps.md``.
        message: one sentence.
        log_tail: last lines of the worker's output, or the planner's traceback.
        attempts: number of attempts.
    """

    kind: str
    message: str
    log_tail: str = ""
    attempts: int = 1

    @property
    def is_unusable(self) -> bool:
        """Whether the input is unusable, so that nothing was started."""
        return self.kind in {"no_scene", "input_error"}


@dataclass(frozen=True)
class Outcome:
    """Outcome of a task: its product or a failure.

    Attributes:
        key: key of the task.
        product: seed scenes, or the one file of a finished episode.
        failed: the failure; None if there is a product.
        wall_s: wall-clock time.
        steps: SUMO steps that a failed episode reached.
        output: printed by planner or policy.
    """

    key: str
    product: tuple[bytes, ...] = ()
    failed: Failed | None = None
    wall_s: float = 0.0
    steps: int = NOT_STARTED
    output: str = ""

    def tried(self, attempts: int) -> Outcome:
        """Return the outcome with the number of attempts in its failure."""
        return self if self.failed is None else replace(self, failed=replace(self.failed, attempts=attempts))


@dataclass(frozen=True)
class WorkerLimits:
    """Limits of a worker.

    Attributes:
        timeout_s: wall-clock limit of one task; may be infinite.
        memory_mb: limit of a worker's private memory; 0 for none.
        tasks: number of tasks after which a worker is replaced.
        recycle_share: a worker that holds this share of ``memory_mb`` is replaced before its next task.
        logs: folder for the workers' output, one file a task.
        plan_timeout_s: wall-clock limit of one plan of target or background; may be infinite.
        log_level: lowest level of this package's log messages in workers, as in :mod:`logging`.
    """

    timeout_s: float
    memory_mb: int
    tasks: int
    recycle_share: float
    logs: Path
    plan_timeout_s: float = math.inf
    log_level: int = logging.WARNING

    def longest_s(self, phase: ProcessPhase) -> float:
        """Return the time limit of one stay in *phase*: a plan, a step of SUMO, or making a planner."""
        if phase is ProcessPhase.OTHER:
            return math.inf
        is_planning = phase in (ProcessPhase.TARGET, ProcessPhase.BACKGROUND)
        return self.plan_timeout_s if is_planning else max(self.plan_timeout_s, STEP_TIMEOUT_S)

    def log_of(self, key: str) -> Path:
        """Return the file for the output of the worker of task *key*."""
        return self.logs / f"{key}.log"

    def heartbeat_of(self, key: str) -> Path:
        """Return the file in which the worker of task *key* writes its progress."""
        return self.logs / f"{key}.heartbeat"
