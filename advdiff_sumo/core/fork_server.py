"""Worker processes whose exit codes may be asked for by several threads; for systems that have a fork server.

The fork server sends an exit code once. Where two threads ask for it at the same time, Python's own class lets the
second one find nothing, and calls that exit code 255: a crash then passes for an end that the process chose. Where the
fork server itself has died, nobody sends anything, and the same class says 255 of each of its processes.
"""

from __future__ import annotations

import os
import threading
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerContext, ForkServerProcess
from multiprocessing.forkserver import read_signed
from multiprocessing.popen_forkserver import Popen
from typing import Any

from advdiff_sumo.core.process_end import UNSEEN


class _SharedPopen(Popen):
    """A process that one thread at a time asks for its exit code."""

    def __init__(self, process: Any) -> None:
        self._asking = threading.Lock()
        super().__init__(process)

    def poll(self, flag: int = os.WNOHANG) -> int | None:
        """Return the exit code, negative for a signal; None while it runs and *flag* says not to wait.

        ``UNSEEN`` where the fork server died first; a process that still runs then is to be given up.
        """
        if self.returncode is None and not wait([self.sentinel], 0 if flag == os.WNOHANG else None):
            return None
        with self._asking:
            if self.returncode is None:
                try:
                    self.returncode = read_signed(self.sentinel)
                except (OSError, EOFError):
                    self.returncode = UNSEEN
            return self.returncode


class SharedProcess(ForkServerProcess):
    """A process of the fork server."""

    @staticmethod
    def _Popen(process_obj: Any) -> Popen:  # noqa: N802 - multiprocessing's name
        return _SharedPopen(process_obj)


class SharedContext(ForkServerContext):
    """Makes such processes; otherwise as ``multiprocessing.get_context("forkserver")``."""

    Process = SharedProcess
