"""Temporary files of a pool are removed, also if its workers are killed."""

from __future__ import annotations

import os
import signal
import tempfile
from pathlib import Path

from pebble import ProcessExpired

from advdiff_sumo.core.worker_pool import futures_of


def leaves_a_folder(killed: bool) -> str:
    folder = tempfile.mkdtemp(prefix="advdiff-")
    if killed:
        os.kill(os.getpid(), signal.SIGKILL)
    return folder


def test_files_left_by_workers_are_removed_with_the_pool() -> None:
    ends = dict(futures_of([(killed, (leaves_a_folder, killed)) for killed in (False, True)], 1))
    assert isinstance(ends[True].exception(), ProcessExpired)
    of_pool = Path(ends[False].result()).parent
    assert of_pool.name.startswith("advdiff-")
    assert not of_pool.exists()
