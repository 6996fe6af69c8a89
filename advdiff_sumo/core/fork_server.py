"""Worker processes whose exit codes several threads may read, on systems that have a fork server.

The fork server sends an exit code once. If two threads read it at the same time, the second one finds nothing, and
Python's own class reports exit code 255. A crash then looks like a regular exit. If the fork server itself has died, no
exit code is sent, and the same class reports 255 for each of its processes.
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
    """A process whose exit code is read by one thread at a time."""

    def __init__(self, process: Any) -> None:
        self._read_lock = threading.Lock()
        super().__init__(process)

    def poll(self, flag: int = os.WNOHANG) -> int | None:
        """Return the exit code, negative for a signal; None while the process runs and *flag* says not to wait.

        ``UNSEEN`` if the fork server died first; a process that still runs then must be abandoned.
        """
        if self.returncode is None and not wait([self.sentinel], 0 if flag == os.WNOHANG else None):
            return None
        with self._read_lock:
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
    """Context that makes such processes, otherwise as ``multiprocessing.get_context("forkserver")``."""

    Process = SharedProcess
