"""What goes to a worker and what comes back; plain values that any process or machine can read."""

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

#: Wall-clock after which SUMO has surely stopped, or a planner that is being made; the start of SUMO with a large net,
#: and the reading of large weights, are within it.
STEP_TIMEOUT_S = 300.0


@dataclass(frozen=True)
class Batch:
    """Seed scenes that are made together: those of one warm-up, or those of a driving log.

    Attributes:
        key: of their content.
        options: of a run that they belong to.
        number: of the stretch of traffic; 0 for a log.
        scenes: how many are wanted: of a warm-up those up to the last one that an episode starts in.
    """

    key: str
    options: RunOptions
    number: int
    scenes: int


@dataclass(frozen=True)
class SceneTask(Batch):
    """Make the seed scenes of one batch.

    Attributes:
        net_digest: of the net, so that one that was changed meanwhile is noticed.
    """

    net_digest: str


@dataclass(frozen=True)
class EpisodeTask:
    """Run one episode.

    Attributes:
        key: of the episode.
        options: of the run that it belongs to.
        number: of the episode in that run.
        scene: its seed scene, see :mod:`advdiff_sumo.sim.scene_file`.
        net_digest: as above.
        ended: how it ended its worker before: what had happened until then is made again and recorded.
    """

    key: str
    options: RunOptions
    number: int
    scene: bytes
    net_digest: str
    ended: Ended | None = None


@dataclass(frozen=True)
class CallTask:
    """Call a function that may do to its process whatever it likes.

    Attributes:
        key: of the task.
        call: the function, with its arguments; both must be found by name in another process.
    """

    key: str
    call: Callable[[], bytes]


Task: TypeAlias = SceneTask | EpisodeTask | CallTask


@dataclass(frozen=True)
class Failed:
    """Why a task came to nothing, or an episode could not be finished.

    Attributes:
        kind: one word, see ``docs/sweeps.md``.
        message: one sentence.
        log_tail: the last lines that the worker said, or where the planner raised.
        attempts: how often it was tried.
    """

    kind: str
    message: str
    log_tail: str = ""
    attempts: int = 1

    @property
    def is_unusable(self) -> bool:
        """Whether the input cannot be used, so that nothing began."""
        return self.kind in {"no_scene", "input_error"}


@dataclass(frozen=True)
class Outcome:
    """What came of a task: its product or a failure.

    Attributes:
        key: of the task.
        product: scenes, or the one file of a finished episode.
        failed: set when there is no product.
        wall_s: how long it took.
        steps: SUMO steps that an episode came to, where it failed without a product.
        said: what a planner or policy printed.
    """

    key: str
    product: tuple[bytes, ...] = ()
    failed: Failed | None = None
    wall_s: float = 0.0
    steps: int = NOT_STARTED
    said: str = ""

    def tried(self, attempts: int) -> Outcome:
        """Return the same with the number of attempts noted in its failure."""
        return self if self.failed is None else replace(self, failed=replace(self.failed, attempts=attempts))


@dataclass(frozen=True)
class WorkerLimits:
    """What a worker may take.

    Attributes:
        timeout_s: wall-clock of one task; may be infinite.
        memory_mb: private memory of a worker; 0 for no limit.
        tasks: a worker is replaced after so many.
        recycle_share: and before its next task once it holds this share of ``memory_mb``.
        logs: folder for what workers say, a file a task.
        plan_timeout_s: wall-clock of one plan of the target or the background; may be infinite.
        log_level: least level of our own messages that a worker says, as in :mod:`logging`.
    """

    timeout_s: float
    memory_mb: int
    tasks: int
    recycle_share: float
    logs: Path
    plan_timeout_s: float = math.inf
    log_level: int = logging.WARNING

    def longest_s(self, phase: ProcessPhase) -> float:
        """Return how long an episode may be in *phase* at a time: a plan, a step of SUMO, the making of a planner."""
        if phase is ProcessPhase.OTHER:
            return math.inf
        plans = phase in (ProcessPhase.TARGET, ProcessPhase.BACKGROUND)
        return self.plan_timeout_s if plans else max(self.plan_timeout_s, STEP_TIMEOUT_S)

    def log_of(self, key: str) -> Path:
        """Return the file that the worker of task *key* writes to."""
        return self.logs / f"{key}.log"

    def heartbeat_of(self, key: str) -> Path:
        """Return the file in which the worker of task *key* notes where it stands."""
        return self.logs / f"{key}.heartbeat"
