"""Options for workers and their limits, for the commands that run episodes in workers."""

from __future__ import annotations

import logging
import math
import os
import shutil
import signal
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

if TYPE_CHECKING:
    from advdiff_sumo.sweep.tasks import WorkerLimits

Workers: TypeAlias = Annotated[
    int | None, typer.Option(min=1, help="Episodes at a time.", show_default="one a core")
]
Timeout: TypeAlias = Annotated[
    float, typer.Option(min=0.1, help="Longest time for one episode, in seconds of the clock.")
]
PlanTimeout: TypeAlias = Annotated[
    float,
    typer.Option(
        "--plan-timeout", min=0.1, help="Longest time for one plan of target or background, in seconds."
    ),
]
Memory: TypeAlias = Annotated[
    int, typer.Option(min=0, help="Most memory of a worker, in MB; 0 for no limit.")
]
PLAN_TIMEOUT_S, MEMORY_MB = 300.0, 4000


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def end_as_by_ctrl_c() -> None:
    """Let SIGTERM end this process in the same way as Ctrl-C, so that finished work is kept."""

    def interrupt(*_signal: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)


def limits_of(
    stack: ExitStack, timeout_s: float, plan_timeout_s: float = math.inf, memory_mb: int = MEMORY_MB
) -> WorkerLimits:
    """Return limits of workers with a temporary folder for logs, which is removed when *stack* is closed."""
    from advdiff_sumo.sweep.tasks import WorkerLimits  # late: --help needs no simulator

    logs = Path(tempfile.mkdtemp(prefix="advdiff-logs-"))
    stack.callback(shutil.rmtree, logs, ignore_errors=True)
    level = logging.getLogger("advdiff_sumo").getEffectiveLevel()
    return WorkerLimits(timeout_s, memory_mb, 250, 0.5, logs, plan_timeout_s, level)
