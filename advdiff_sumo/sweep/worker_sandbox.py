"""Run a task in a process that may die: with a time limit, a memory limit, and a log that survives the process."""

from __future__ import annotations

import contextlib
import faulthandler
import logging
import math
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import count
from multiprocessing import parent_process
from pathlib import Path
from typing import IO

import pyarrow as pa

from advdiff_sumo.core.output import flush_output
from advdiff_sumo.core.plug_in_source import crashed_at
from advdiff_sumo.core.process_end import UNSEEN
from advdiff_sumo.core.threads import one_thread_for_good
from advdiff_sumo.core.worker_start import ignore_interrupts, keep_temporary_files_in
from advdiff_sumo.sim.heartbeat import NOT_STARTED, Beat, Heartbeat, ProcessPhase
from advdiff_sumo.sweep.tasks import EpisodeTask, Failed, Outcome, Task, WorkerLimits
from advdiff_sumo.sweep.work import data_bytes, failed_by, perform, rss_mb

#: Exit code of a worker that ends to be replaced by a new one.
RECYCLED = 75
_FROM_OUTSIDE = {-9, -15, UNSEEN}  # SIGKILL, such as by the system without free memory, and SIGTERM
# texts of faulthandler:
_TIMED_OUT = re.compile(r"^Timeout \(\d+:\d\d:\d\d", re.MULTILINE)
_CRASHED, _MODULES = "Fatal Python error", "Extension modules:"
_MAKING = (ProcessPhase.MAKING_TARGET, ProcessPhase.MAKING_BACKGROUND)
_READ_BYTES = 1 << 16  # of the end of a log
_TAIL, _BEFORE_STACK = 4000, 1000  # characters kept: in all, and before a stack
_MB = 1 << 20
_TASKS = count()  # tasks of this process


def prepare_worker(limits: WorkerLimits) -> None:
    """Set up a new worker: it ignores Ctrl-C, has bounded memory, and ends with its parent.

    Its temporary files, and those of programs that it starts, are in a folder that the parent removes.
    """
    ignore_interrupts()
    bound_memory(limits.memory_mb)
    keep_temporary_files_in(limits.logs)
    if limits.log_level < logging.WARNING:
        logging.basicConfig(format="%(name)s: %(message)s")
        logging.getLogger("advdiff_sumo").setLevel(limits.log_level)
    threading.Thread(target=_follow_parent, daemon=True).start()


def bound_memory(memory_mb: int) -> None:
    """Limit the further private memory of this process to *memory_mb*; 0 for no limit.

    Only writable memory counts, not address space that libraries merely reserve. An existing limit stays.
    """
    if memory_mb and sys.platform != "win32":
        import resource

        if resource.getrlimit(resource.RLIMIT_DATA)[0] == resource.RLIM_INFINITY:
            limit_bytes = memory_mb * _MB + data_bytes()
            resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, limit_bytes))


def run_sandboxed(task: Task, limits: WorkerLimits) -> Outcome:
    """Perform *task* within *limits*; the process ends itself at the time limit."""
    is_used = next(_TASKS) > 0
    if is_used and limits.memory_mb and rss_mb() > limits.recycle_share * limits.memory_mb:
        os._exit(RECYCLED)
    one_thread_for_good()
    pa.set_cpu_count(1)
    heartbeat_file = limits.heartbeat_of(task.key)
    with _watched(limits.log_of(task.key), limits.timeout_s) as output:
        outcome = replace(perform(task, Heartbeat(heartbeat_file)), output=output())
        if outcome.failed is not None and not outcome.failed.log_tail:
            outcome = replace(outcome, failed=replace(outcome.failed, log_tail=outcome.output))
    with contextlib.suppress(OSError):
        heartbeat_file.unlink()
    return outcome


def outcome_of_dead_worker(
    task: Task, limits: WorkerLimits, exit_code: int | None, how: str, overdue: bool = False
) -> Outcome:
    """Return the outcome of a task whose worker died.

    Args:
        task: the task.
        limits: limits of the worker.
        exit_code: exit code of the process, negative for a signal; None if unknown.
        how: how it ended, as the end of a sentence; "" if it was ended at its time limit.
        overdue: whether it was ended because a plan, a step of SUMO or making a planner took too long.
    """
    tail, beat = _left_behind(task, limits)
    steps = NOT_STARTED if beat is None else beat.steps
    if overdue and beat is not None and isinstance(task, EpisodeTask):
        failed = _overdue(task, limits, beat, tail)
    elif _TIMED_OUT.search(tail) or not how:
        failed = timed_out(limits, tail)
    elif (
        isinstance(task, EpisodeTask)
        and beat is not None
        and beat.phase is not ProcessPhase.OTHER
        and exit_code is not None
        and exit_code not in _FROM_OUTSIDE
    ):
        failed = _crashed(task, beat, how, tail)
    else:
        failed = Failed("worker_died", f"the worker {how}", tail)
    return Outcome(task.key, (), failed, steps=steps)


def outcome_without_answer(task: Task, limits: WorkerLimits, error: Exception) -> Outcome:
    """Return the outcome of a task whose worker lives, but raised *error* while it handled a fault."""
    _, beat = _left_behind(task, limits)
    return Outcome(task.key, (), failed_by(error), steps=NOT_STARTED if beat is None else beat.steps)


def _left_behind(task: Task, limits: WorkerLimits) -> tuple[str, Beat | None]:
    """Return the end of the log of a task and its last heartbeat, and remove both files."""
    log, heartbeat = limits.log_of(task.key), limits.heartbeat_of(task.key)
    tail, beat = tail_of(log), Heartbeat.read(heartbeat)
    for file in (log, heartbeat):
        with contextlib.suppress(OSError):
            file.unlink()
    return tail, beat


def _crashed(task: EpisodeTask, beat: Beat, how: str, tail: str) -> Failed:
    """Return the failure of an episode in which the simulator or a user's code ended the process."""
    when = _when_text(task, beat)
    if beat.phase is ProcessPhase.SIMULATOR:
        return Failed("simulator_crashed", f"SUMO crashed {when}: the worker {how}", tail)
    driver = _driver_name(task, beat.phase)
    return Failed(
        "planner_crashed", f"{driver} ended its process {when}{crashed_at(tail)}: the worker {how}", tail
    )


def _overdue(task: EpisodeTask, limits: WorkerLimits, beat: Beat, tail: str) -> Failed:
    """Return the failure of an episode that was stuck in one plan, one step of SUMO, or making a planner."""
    when = _when_text(task, beat)
    if beat.phase is ProcessPhase.SIMULATOR:
        return Failed("timeout", f"SUMO made no step in {limits.longest_s(beat.phase):g} s {when}", tail)
    driver, within = _driver_name(task, beat.phase), f"in {limits.longest_s(beat.phase):g} s"
    delay = f"was not made {within}" if beat.phase in _MAKING else f"made no plan {within} {when}"
    problem = f"{driver} {delay}{crashed_at(tail)}"
    return Failed("planner_timeout", problem, tail)


def _driver_name(task: EpisodeTask, phase: ProcessPhase) -> str:
    """Return the name of target or background, whichever is active in *phase*."""
    options = task.options
    of_target = phase in (ProcessPhase.TARGET, ProcessPhase.MAKING_TARGET)
    return f"target '{options.target}'" if of_target else f"background '{options.background}'"


def _when_text(task: EpisodeTask, beat: Beat) -> str:
    """Return when in the episode *beat* was, as the end of a sentence."""
    if beat.phase in _MAKING:
        return "while it was made"
    if beat.steps < 0:
        return "before the first step"
    return f"at {beat.steps * task.options.sim.step_s:.1f} s of the episode"


def timed_out(limits: WorkerLimits, tail: str = "") -> Failed:
    """Return the failure of a task that exceeded its time limit."""
    return Failed("timeout", f"not finished after {limits.timeout_s:g} s", tail)


def tail_of(log: Path) -> str:
    """Return the end of *log*; "" if it is missing, as for a worker on another machine.

    If the log holds a stack of Python's, that is returned with the lines before it; its innermost call is first.
    """
    try:
        text = log.read_bytes()[-_READ_BYTES:].decode(errors="replace")
    except OSError:
        return ""
    text = "\n".join(line for line in text.splitlines() if not line.startswith(_MODULES))
    stack = max([text.rfind(_CRASHED), *(match.start() for match in _TIMED_OUT.finditer(text))])
    if stack >= 0:
        return text[max(0, stack - _BEFORE_STACK) : stack + _TAIL].strip()
    tail, full = text[-_TAIL:].strip(), text.strip()
    return tail if tail == full else f"… (of what was printed the last {_TAIL} characters)\n{tail}"


def _follow_parent() -> None:
    """End this process when its parent ends."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def _watched(log: Path, timeout_s: float) -> Iterator[Callable[[], str]]:
    """Redirect the output of this process to *log*; at the time limit write the stack there and end the process."""
    with log.open("wb") as file:
        saved = os.dup(1), os.dup(2)
        flush_output()
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        faulthandler.enable(file=file)
        end_after(timeout_s, file)
        try:
            yield partial(_text_so_far, log)
        finally:
            faulthandler.cancel_dump_traceback_later()
            faulthandler.disable()
            flush_output()
            for descriptor, original in zip((1, 2), saved, strict=True):
                os.dup2(original, descriptor)
                os.close(original)
    with contextlib.suppress(OSError):
        log.unlink()


def _text_so_far(log: Path) -> str:
    """Return the end of what this process has written to *log*."""
    flush_output()
    return tail_of(log)


def end_after(timeout_s: float, file: IO[bytes] | None = None) -> None:
    """After *timeout_s* (inf: never) write this process's stack to *file*, or standard error, and end it."""
    if math.isfinite(timeout_s):
        faulthandler.dump_traceback_later(
            min(timeout_s, threading.TIMEOUT_MAX), exit=True, file=sys.stderr if file is None else file
        )
