"""Who does the tasks: this process, or processes of this machine; Ray is in a module of its own."""

from __future__ import annotations

import multiprocessing
from collections import deque
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from multiprocessing.context import BaseContext
from types import TracebackType
from typing import Any, Protocol, Self

from pebble import ProcessExpired, ProcessPool

from advdiff_sumo.core.process_end import how_it_ended
from advdiff_sumo.sweep.tasks import Limits, Outcome, Task
from advdiff_sumo.sweep.work import perform
from advdiff_sumo.sweep.worker_sandbox import (
    RECYCLED,
    lost,
    prepare_worker,
    run_sandboxed,
    tail_of,
    timed_out,
)

_WORKER = "pebble_pool_worker"  # the name that pebble gives its processes
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all workers; at once where an error or Ctrl-C is the reason."""
        ...

    def submit(self, task: Task) -> None:
        """Take *task*; never more of them than there are slots."""
        ...

    def wait(self) -> Outcome:
        """Return the outcome of some task, as soon as there is one."""
        ...


class SerialExecutor(AbstractContextManager["SerialExecutor"]):
    """Does one task after the other in this process: for debugging, without limits or protection."""

    slots = 1

    def __init__(self) -> None:
        self._tasks: deque[Task] = deque()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to end."""

    def submit(self, task: Task) -> None:
        """Take *task*."""
        self._tasks.append(task)

    def wait(self) -> Outcome:
        """Do the task that was taken first."""
        return perform(self._tasks.popleft())


class ProcessExecutor(AbstractContextManager["ProcessExecutor"]):
    """Processes of this machine; one may crash, hang or be killed, and only its task is lost.

    Each worker has a pool of its own: in a shared one a worker that dies while it holds the lock of the common
    pipe stops all others.
    """

    def __init__(self, workers: int, limits: Limits) -> None:
        self.slots, self.limits = workers, limits
        self._pools: dict[int, Any] = {}
        self._running: dict[Any, tuple[int, Task]] = {}

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        timeout = self.limits.timeout_s + _GRACE_S
        try:
            future = self._pool(slot).schedule(run_sandboxed, (task, self.limits), timeout=timeout)
        except RuntimeError:  # the worker was killed while it was idle, and its pool gave up
            self._discard(slot)
            future = self._pool(slot).schedule(run_sandboxed, (task, self.limits), timeout=timeout)
        self._running[future] = slot, task

    def wait(self) -> Outcome:
        """Wait for any worker."""
        done, _ = wait(self._running, return_when=FIRST_COMPLETED)
        future = min(done, key=lambda f: self._running[f][0])
        slot, task = self._running.pop(future)
        limits = self.limits
        try:
            made: Outcome = future.result()
        except FutureTimeoutError:
            return Outcome(task.key, (), timed_out(limits, tail_of(limits.log_of(task.key))))
        except ProcessExpired as error:
            if error.exitcode == RECYCLED:
                self.submit(task)
                return self.wait()
            return lost(task.key, limits, how_it_ended(error.exitcode))
        except BrokenProcessPool:
            self._discard(slot)
            return lost(task.key, limits, "was killed while it took the task")
        return made

    def workers(self) -> list[int]:
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
                context=_context(),
            )
        return self._pools[slot]

    def _discard(self, slot: int) -> None:
        pool = self._pools.pop(slot)
        pool.stop()
        pool.join()


def _context() -> BaseContext:
    """Return how workers are started: from a clean process that has the modules loaded, where there is one."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["advdiff_sumo.sweep.worker_sandbox"])
    return context
