"""Start worker processes from a fork server that has imported the modules they need, if the system has one.

Each command has one of Python's fork servers, so that PyTorch is imported once and not once per worker.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Iterable
from multiprocessing.context import BaseContext
from pathlib import Path

from advdiff_sumo.core.errors import ConfigError

FORK_SERVER = "forkserver"


def worker_context(modules: Iterable[str]) -> BaseContext:
    """Return the context that makes workers, and start the fork server, which imports *modules* in the background.

    The fork server ignores Ctrl-C. Workers have SIGINT blocked until :func:`ignore_interrupts` is called.

    Args:
        modules: modules that workers need. The fork server imports those of the first call; each worker imports others.

    Raises:
        ConfigError: the path of the folder for temporary files is too long for a socket.
    """
    if FORK_SERVER not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import resource_tracker
    from multiprocessing.forkserver import ensure_running  # not available on every system

    from advdiff_sumo.core.fork_server import SharedContext

    context = SharedContext()
    context.set_forkserver_preload([module for module in modules if module != "__main__"])
    resource_tracker.ensure_running()  # the fork server starts it, too, and that unblocks SIGINT
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        ensure_running()
    except OSError as error:
        raise ConfigError(
            f"no worker process can be started, as their socket cannot lie in {tempfile.gettempdir()} ({error}); "
            "let TMPDIR name a folder with a shorter path"
        ) from None
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    return context


def ignore_interrupts() -> None:
    """Ignore Ctrl-C in this worker, since the process that started it ends its workers itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):  # blocked since the fork server was started
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def keep_temporary_files_in(folder: Path) -> None:
    """Put temporary files of this process, and of the programs that it starts, into *folder*.

    A worker that is ended or killed leaves them there; its parent removes the folder.
    """
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
