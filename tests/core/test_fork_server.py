"""Exit codes of worker processes that several threads read at once."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from advdiff_sumo.core.fork_server import SharedContext, SharedProcess

PROCESSES, THREADS = 12, 4


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


@pytest.fixture
def hasty_threads() -> Iterator[None]:
    """Threads that interrupt each other far more often than usual."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def asked(process: SharedProcess, together: threading.Barrier) -> int:
    together.wait()
    while process.exitcode is None:
        pass
    return process.exitcode


def test_every_thread_reads_the_exit_code_of_a_crash(hasty_threads: None) -> None:
    """With Python's own class two in three of these processes report exit code 255."""
    context = SharedContext()
    for _ in range(PROCESSES):
        process = context.Process(target=crash)
        process.start()
        with ThreadPoolExecutor(THREADS) as threads:
            together = threading.Barrier(THREADS)
            heard = [threads.submit(asked, process, together) for _ in range(THREADS)]
        assert [one.result() for one in heard] == THREADS * [-signal.SIGSEGV]
        process.join()


def test_a_wait_ends_with_the_process() -> None:
    process = SharedContext().Process(target=crash)
    process.start()
    process.join()
    assert (process.exitcode, process.is_alive()) == (-signal.SIGSEGV, False)
