"""The failure that is recorded when a worker has died."""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
from collections.abc import Callable
from multiprocessing import forkserver

import pytest

from advdiff_sumo.core.errors import AdvdiffError
from advdiff_sumo.core.process_end import UNSEEN, how_it_ended
from advdiff_sumo.sim.heartbeat import Heartbeat, ProcessPhase
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sweep.executors import ProcessExecutor, outcome_of
from advdiff_sumo.sweep.tasks import CallTask, EpisodeTask, WorkerLimits
from advdiff_sumo.sweep.worker_sandbox import outcome_of_dead_worker
from tests.hang_guard import HANG_S


@pytest.mark.parametrize(("exit_code", "kind"), [(UNSEEN, "worker_died"), (3, "planner_crashed")])
def test_a_planner_is_blamed_only_if_the_exit_code_is_known(
    exit_code: int, kind: str, limits: WorkerLimits
) -> None:
    task = EpisodeTask("key", RunOptions(net="downtown"), 0, b"", "")
    Heartbeat(limits.heartbeat_of(task.key)).note(ProcessPhase.TARGET, 7)
    outcome = outcome_of_dead_worker(task, limits, exit_code, how_it_ended(exit_code))
    assert outcome.failed is not None
    assert (outcome.failed.kind, outcome.steps) == (kind, 7)


def sleeps() -> bytes:
    time.sleep(HANG_S)
    return b""


def answers() -> bytes:
    return b"here"


def test_after_the_death_of_the_fork_server_new_workers_start(
    limits: WorkerLimits,
) -> None:
    with ProcessExecutor(1, limits) as executor:
        executor.submit(CallTask("sleeps", sleeps))
        while not limits.log_of("sleeps").exists():
            time.sleep(0.01)
        (worker,) = executor.workers()
        os.kill(forkserver._forkserver._forkserver_pid, signal.SIGKILL)  # type: ignore[attr-defined] # not public
        failed = executor.wait().failed
        assert failed is not None
        assert (failed.kind, failed.message) == (
            "worker_died",
            "the worker was lost with the process that workers come from, which was ended from outside",
        )
        assert outcome_of(CallTask("answers", answers), executor).product == (b"here",)
        assert worker not in executor.workers()


class HungryError(AdvdiffError):
    """An error whose message takes more memory than there is."""

    def __str__(self) -> str:
        raise MemoryError


def lacks_memory_while_failing() -> bytes:
    raise HungryError


def system_lacks_memory() -> bytes:
    raise OSError(errno.ENOMEM, "Cannot allocate memory")


@pytest.mark.parametrize("call", [lacks_memory_while_failing, system_lacks_memory])
def test_a_lack_of_memory_costs_its_own_task_only(call: Callable[[], bytes], limits: WorkerLimits) -> None:
    with ProcessExecutor(1, limits) as executor:
        failed = outcome_of(CallTask("fails", call), executor).failed
        assert failed is not None
        assert failed.kind == "out_of_memory"
        assert failed.message.startswith("the worker ran out of memory")
        assert call.__name__ in failed.log_tail
        assert outcome_of(CallTask("answers", answers), executor).product == (b"here",)
    assert list(limits.logs.iterdir()) == []


def closes_output() -> bytes:
    sys.stdout.write("before\n")
    sys.stdout.close()
    sys.stderr = None  # type: ignore[assignment] # on purpose
    return b"closed"


def test_a_planner_may_close_its_output(limits: WorkerLimits) -> None:
    with ProcessExecutor(1, limits) as executor:
        closed = outcome_of(CallTask("closes", closes_output), executor)
        assert (closed.product, closed.output) == ((b"closed",), "before")
        assert outcome_of(CallTask("answers", answers), executor).product == (b"here",)
