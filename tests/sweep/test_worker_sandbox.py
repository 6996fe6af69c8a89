"""The failure that is recorded when a worker has died."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing import forkserver

import pytest

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
