"""Keep two processes from writing the results of one folder at the same time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from advdiff_sumo.core.errors import FileError


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Refuse the block if another process is in one for *folder*; the system ends a lock with its process.

    Without locks (Windows, some network disks) the block always runs.

    Raises:
        FileError: another process writes into the folder.
    """
    if os.name != "posix":
        yield
        return
    import fcntl  # late: Windows has none

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            problem = "another process is writing into it"
            raise FileError(folder, problem, "wait for its end, or choose a new --out") from None
        except OSError:  # a disk without locks
            pass
        yield
    finally:
        os.close(descriptor)
