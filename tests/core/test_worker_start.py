"""The fork server is deaf to Ctrl-C from its first instruction on, while it imports modules for seconds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

_BLOCKED = """
import os, signal
from multiprocessing import forkserver
from pathlib import Path
from advdiff_sumo.core.worker_start import worker_context

worker_context([])
status = Path(f"/proc/{forkserver._forkserver._forkserver_pid}/status").read_text()
blocked = next(line for line in status.splitlines() if line.startswith("SigBlk")).split()[1]
print(bool(int(blocked, 16) & 1 << signal.SIGINT - 1))
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="/proc tells which signals are blocked")
def test_the_fork_server_of_a_fresh_process_has_ctrl_c_blocked() -> None:
    told = subprocess.run([sys.executable, "-c", _BLOCKED], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "True"
