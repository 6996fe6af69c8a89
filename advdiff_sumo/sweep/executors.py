"""Who does the tasks: this process, or processes of this machine; Ray is in a module of its own."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from multiprocessing.context import BaseContext
from typing import Any, Protocol, Self

from pebble import ProcessExpired, ProcessPool

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.process_end import how_it_ended
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.core.worker_start import worker_context
from advdiff_sumo.planners.planner_protocol import Served
from advdiff_sumo.planners.planner_registry import TARGETS
from advdiff_sumo.sim.heartbeat import Heartbeat
from advdiff_sumo.sim.run_episodes import Run
from advdiff_sumo.sweep.tasks import CallTask, Outcome, Task, WorkerLimits
from advdiff_sumo.sweep.work import perform
from advdiff_sumo.sweep.worker_sandbox import (
    RECYCLED,
    lost,
    prepare_worker,
    run_sandboxed,
)
from advdiff_sumo.traffic.policy_registry import POLICIES

_WORKER = "pebble_pool_worker"  # the name that pebble gives its processes
_LOOK_S = 1.0  # between looks at where the workers stand
_GRACE_S = 10.0  # a worker ends itself at its time limit; this much later it is ended from outside


class Executor(Protocol):
    """Does tasks, as many at once as it has slots.

    Every executor gives the same outcomes for the same tasks, in whatever order.

    Attributes:
        slots: how many tasks it can hold.
    """

    slots: int

    def __enter__(self) -> Self:
        """Start; nothing runs before."""
        ...

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """End all workers; at once where an error or Ctrl-C is the reason."""
        ...

    def submit(self, task: Task) -> None:
        """Take *task*; never more of them than there are slots."""
        ...

    def wait(self) -> Outcome:
        """Return the outcome of some task, as soon as there is one."""
        ...


def outcome_of(task: Task, executor: Executor) -> Outcome:
    """Return what comes of *task* alone."""
    executor.submit(task)
    return executor.wait()


def outcomes(tasks: Iterable[Task], executor: Executor) -> Iterator[Outcome]:
    """Yield what comes of *tasks*, as they finish."""
    waiting, running = deque(tasks), 0
    while waiting or running:
        while waiting and running < executor.slots:
            executor.submit(waiting.popleft())
            running += 1
        yield executor.wait()
        running -= 1


class SerialExecutor(AbstractContextManager["SerialExecutor"]):
    """Does one task after the other in this process: for debugging, without limits or protection.

    Attributes:
        run: that all episodes are of, with its planner, policy and window; None: they are made of each task's options.
    """

    slots = 1

    def __init__(self, run: Run | None = None) -> None:
        self.run = run
        self._tasks: deque[Task] = deque()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Let the planner go where something outside this process stands behind it."""
        if self.run is not None and isinstance(self.run.target, Served):
            self.run.target.close()

    def submit(self, task: Task) -> None:
        """Take *task*."""
        self._tasks.append(task)

    def wait(self) -> Outcome:
        """Do the task that was taken first."""
        with one_thread():
            return perform(self._tasks.popleft(), run=self.run)


class ProcessExecutor(AbstractContextManager["ProcessExecutor"]):
    """Processes of this machine; one may crash, hang or be killed, and only its task is lost.

    Each worker has a pool of its own: in a shared one a worker that dies while it holds the lock of the common
    pipe stops all others.
    """

    def __init__(self, workers: int, limits: WorkerLimits) -> None:
        self.slots, self.limits = workers, limits
        self._pools: dict[int, Any] = {}
        self._running: dict[Any, tuple[int, Task]] = {}
        self._overdue: dict[str, float] = {}

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """End the workers."""
        for pool in self._pools.values():
            if kind is None:
                pool.close()
            else:
                pool.stop()
        for pool in self._pools.values():
            pool.join()
        self._pools.clear()

    def submit(self, task: Task) -> None:
        """Give *task* to a free worker."""
        busy = {slot for slot, _ in self._running.values()}
        slot = next(k for k in range(self.slots) if k not in busy)
        timeout = self.limits.timeout_s + _GRACE_S if math.isfinite(self.limits.timeout_s) else None
        try:
            future = self._pool(slot).schedule(run_sandboxed, (task, self.limits), timeout=timeout)
        except RuntimeError:  # the worker was killed while it was idle, and its pool gave up
            self._discard(slot)
            future = self._pool(slot).schedule(run_sandboxed, (task, self.limits), timeout=timeout)
        self._running[future] = slot, task

    def wait(self) -> Outcome:
        """Wait for any worker."""
        done: set[Any] = set()
        while not done:
            done, _ = wait(self._running, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
            self._end_overdue()
        future = min(done, key=lambda f: self._running[f][0])
        slot, task = self._running.pop(future)
        limits = self.limits
        try:
            outcome: Outcome = future.result()
        except FutureTimeoutError:
            return lost(task, limits, None, "")
        except ProcessExpired as error:
            if error.exitcode == RECYCLED:
                self.submit(task)
                return self.wait()
            overdue = self._overdue.pop(task.key, None) is not None
            return lost(task, limits, error.exitcode, how_it_ended(error.exitcode), overdue)
        except BrokenProcessPool:
            self._discard(slot)
            return lost(task, limits, None, "was killed while it took the task")
        self._overdue.pop(task.key, None)
        return outcome

    def _end_overdue(self) -> None:
        """End workers that have been at one plan, or one step of SUMO, for too long."""
        for _, task in self._running.values():
            beat = Heartbeat.read(self.limits.heartbeat_of(task.key))
            now = time.monotonic()
            if beat is None or now - beat.since_s <= self.limits.longest_s(beat.phase):
                continue
            asked = self._overdue.setdefault(task.key, now)
            with contextlib.suppress(ProcessLookupError):  # it says where it is stuck; or else it is killed
                os.kill(beat.pid, signal.SIGABRT if now - asked < _GRACE_S else signal.SIGKILL)

    @staticmethod
    def workers() -> list[int]:
        """Return the process numbers of the workers that are there now."""
        alive = (w for w in multiprocessing.active_children() if w.name == _WORKER)
        return sorted(worker.pid for worker in alive if worker.pid is not None)

    def _pool(self, slot: int) -> Any:
        if slot not in self._pools:
            limits = self.limits
            self._pools[slot] = ProcessPool(
                max_workers=1,
                max_tasks=limits.tasks,
                initializer=prepare_worker,
                initargs=(limits,),
                context=prepare_workers(),
            )
        return self._pools[slot]

    def _discard(self, slot: int) -> None:
        pool = self._pools.pop(slot)
        pool.stop()
        pool.join()


def call_in_worker(
    name: str, call: Callable[[], bytes], limits: WorkerLimits, hear: Callable[[str], None]
) -> Outcome:
    """Return what comes of *call* in a process of its own.

    Args:
        name: of the task.
        call: what is called; what it returns is the outcome's product.
        limits: of the worker.
        hear: called with what was printed.

    Raises:
        ConfigError: the input cannot be used.
    """
    with ProcessExecutor(1, limits) as executor:
        outcome = outcome_of(CallTask(name, call), executor)
    if outcome.said:
        hear(outcome.said)
    if outcome.failed is not None and outcome.failed.is_unusable:
        raise ConfigError(outcome.failed.message)
    return outcome


def prepare_workers(modules: Iterable[str] = ()) -> BaseContext:
    """Let the process that workers come from start now, and import while this one goes on; return what makes workers.

    Args:
        modules: that workers will need, beside those of built-in planners and policies that this process has loaded.
    """
    builtins = {
        registry.builtin_module(name) for registry in (TARGETS, POLICIES) for name in registry.builtins
    }
    loaded = sorted(module for module in builtins if module in sys.modules)
    # every worker filters speeds by scipy.signal, which this process need not wait for
    return worker_context(["advdiff_sumo.sweep.worker_sandbox", "scipy.signal", *modules, *loaded])
