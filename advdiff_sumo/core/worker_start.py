"""How worker processes of this machine begin: from one clean process that has imported what they need, if there is one.

Python's own fork server, one for each command: PyTorch is imported once, not once a worker.
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
    """Return what makes workers. The process that they come from starts now, deaf to Ctrl-C, and imports meanwhile.

    Workers have SIGINT blocked until :func:`ignore_interrupts` is called.

    Args:
        modules: that workers will need. Those of the first call are loaded before; others each worker imports itself.

    Raises:
        ConfigError: the folder of temporary files has no room for a socket's path.
    """
    if FORK_SERVER not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing.forkserver import ensure_running  # not there on every system

    from advdiff_sumo.core.fork_server import SharedContext

    context = SharedContext()
    context.set_forkserver_preload([module for module in modules if module != "__main__"])
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
    """Leave Ctrl-C to the process that started this worker, for it ends its workers itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):  # blocked since the server of workers was started
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def keep_temporary_files_in(folder: Path) -> None:
    """Let temporary files of this process, and of the programs that it starts, lie in *folder*.

    A worker that is ended or killed leaves them behind; its parent removes the folder.
    """
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
