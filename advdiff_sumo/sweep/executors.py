"""Execute tasks in this process or in processes of this machine; Ray is in a separate module."""

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
    outcome_of_dead_worker,
    outcome_without_answer,
    prepare_worker,
    run_sandboxed,
)
from advdiff_sumo.traffic.policy_registry import POLICIES

_WORKER = "pebble_pool_worker"  # the name that pebble gives its processes
_POLL_S = 1.0  # between checks of the workers' progress
_GRACE_S = 10.0  # a worker that does not end itself at its time limit is ended so much later


class Executor(Protocol):
    """Executes tasks, as many at once as it has slots.

    All executors return the same outcomes for the same tasks, in any order.

    Attributes:
        slots: number of tasks that it can hold.
    """

    slots: int

    def __enter__(self) -> Self:
        """Start the workers."""
        ...

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """End all workers; immediately after an error or Ctrl-C."""
        ...

    def submit(self, task: Task) -> None:
        """Accept *task*; there must be a free slot."""
        ...

    def wait(self) -> Outcome:
        """Wait for any task, and return its outcome."""
        ...


def outcome_of(task: Task, executor: Executor) -> Outcome:
    """Execute a single task and return its outcome."""
    executor.submit(task)
    return executor.wait()


def outcomes(tasks: Iterable[Task], executor: Executor) -> Iterator[Outcome]:
    """Yield the outcomes of *tasks* as they finish."""
    waiting, running = deque(tasks), 0
    while waiting or running:
        while waiting and running < executor.slots:
            executor.submit(waiting.popleft())
            running += 1
        yield executor.wait()
        running -= 1


class SerialExecutor(AbstractContextManager["SerialExecutor"]):
    """Executes one task after the other in this process: for debugging, without limits or protection.

    Attributes:
        run: run of all episodes, with its planner, policy and window; None: prepared from each task's options.
    """

    slots = 1

    def __init__(self, run: Run | None = None) -> None:
        self.run = run
        self._tasks: deque[Task] = deque()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Close the planner if it uses a resource outside this process."""
        if self.run is not None and isinstance(self.run.target, Served):
            self.run.target.close()

    def submit(self, task: Task) -> None:
        """Accept *task*."""
        self._tasks.append(task)

    def wait(self) -> Outcome:
        """Perform the task that was submitted first."""
        with one_thread():
            return perform(self._tasks.popleft(), run=self.run)


class ProcessExecutor(AbstractContextManager["ProcessExecutor"]):
    """Processes of this machine. If one crashes, hangs or is killed, only its task is lost.

    Each worker has a pool of its own: in a shared pool, a worker that dies while holding the lock of the common pipe
    would block all others.
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
        """Pass *task* to a free worker."""
        busy = {slot for slot, _ in self._running.values()}
        slot = next(k for k in range(self.slots) if k not in busy)
        timeout = self.limits.timeout_s + _GRACE_S if math.isfinite(self.limits.timeout_s) else None
        try:
            future = self._pool(slot).schedule(run_sandboxed, (task, self.limits), timeout=timeout)
        except RuntimeError:  # the worker was killed while idle, and its pool stopped
            self._discard(slot)
            future = self._pool(slot).schedule(run_sandboxed, (task, self.limits), timeout=timeout)
        self._running[future] = slot, task

    def wait(self) -> Outcome:
        """Wait for any worker."""
        done: set[Any] = set()
        while not done:
            done, _ = wait(self._running, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            self._end_overdue()
        future = min(done, key=lambda candidate: self._running[candidate][0])
        slot, task = self._running.pop(future)
        limits = self.limits
        try:
            outcome: Outcome = future.result()
        except FutureTimeoutError:
            return outcome_of_dead_worker(task, limits, None, "")
        except ProcessExpired as error:
            if error.exitcode == RECYCLED:
                self.submit(task)
                return self.wait()
            overdue = self._overdue.pop(task.key, None) is not None
            return outcome_of_dead_worker(task, limits, error.exitcode, how_it_ended(error.exitcode), overdue)
        except BrokenProcessPool:
            self._discard(slot)
            return outcome_of_dead_worker(task, limits, None, "was killed while it took the task")
        except Exception as error:  # noqa: BLE001 - without memory, handling a fault fails in any way
            self._discard(slot)
            outcome = outcome_without_answer(task, limits, error)
        self._overdue.pop(task.key, None)
        return outcome

    def _end_overdue(self) -> None:
        """End workers that have spent too long on one plan or one step of SUMO."""
        for _, task in self._running.values():
            beat = Heartbeat.read(self.limits.heartbeat_of(task.key))
            now_s = time.monotonic()
            if beat is None or now_s - beat.since_s <= self.limits.longest_s(beat.phase):
                continue
            first_signal_s = self._overdue.setdefault(task.key, now_s)
            # SIGABRT makes it write its stack; SIGKILL if it survives that
            with contextlib.suppress(ProcessLookupError):
                os.kill(beat.pid, signal.SIGABRT if now_s - first_signal_s < _GRACE_S else signal.SIGKILL)

    @staticmethod
    def workers() -> list[int]:
        """Return the process ids of the living workers."""
        alive = (process for process in multiprocessing.active_children() if process.name == _WORKER)
        return sorted(worker.pid for worker in alive if worker.pid is not None)

    def _pool(self, slot: int) -> Any:
        """Return the pool of *slot*, started if need be."""
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
        """Stop the pool of *slot*."""
        pool = self._pools.pop(slot)
        pool.stop()
        pool.join()


def call_in_worker(
    name: str, call: Callable[[], bytes], limits: WorkerLimits, on_output: Callable[[str], None]
) -> Outcome:
    """Call *call* in a separate process and return the outcome.

    Args:
        name: key of the task.
        call: the function; what it returns is the product.
        limits: limits of the worker.
        on_output: called with what was printed.

    Raises:
        ConfigError: the input is unusable.
    """
    with ProcessExecutor(1, limits) as executor:
        outcome = outcome_of(CallTask(name, call), executor)
    if outcome.output:
        on_output(outcome.output)
    if outcome.failed is not None and outcome.failed.is_unusable:
        raise ConfigError(outcome.failed.message)
    return outcome


def prepare_workers(modules: Iterable[str] = ()) -> BaseContext:
    """Return the context that starts workers; its server process starts now and imports modules in the background.

    Args:
        modules: modules that workers need, besides those of built-in planners and policies loaded in this process.
    """
    builtins = {
        registry.builtin_module(name) for registry in (TARGETS, POLICIES) for name in registry.builtins
    }
    loaded = sorted(module for module in builtins if module in sys.modules)
    # every worker needs scipy.signal to filter speeds; this process need not wait for its import
    return worker_context(["advdiff_sumo.sweep.worker_sandbox", "scipy.signal", *modules, *loaded])
