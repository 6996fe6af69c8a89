"""The folder of a planner's server is removed when the process that started it ends, in any way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.planners.remote.planner_process import PlannerProcess
from tests.hang_guard import HANG_S

STARTS = """
import os, signal, sys
from advdiff_sumo.planners.remote.planner_process import PlannerProcess

process = PlannerProcess(f"{sys.executable} -c 'import time; time.sleep(600)'", "a test")
print(process._folder, flush=True)
if sys.argv[1] == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
if sys.argv[1] == "worker":
    os._exit(0)  # as workers end
"""


@pytest.mark.parametrize(("ends", "code"), [("killed", -signal.SIGKILL), ("worker", 0), ("itself", 0)])
def test_a_folder_does_not_outlive_the_process_that_made_it(ends: str, code: int) -> None:
    command = [sys.executable, "-c", STARTS, ends]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False, timeout=HANG_S)
    folder, until = Path(done.stdout.strip()), time.monotonic() + HANG_S
    assert (done.returncode, folder.name.startswith("advdiff-planner-")) == (code, True)
    while folder.exists():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.parametrize("no_process", [False, True])
def test_a_failed_start_leaves_no_folder(
    no_process: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    if no_process:
        monkeypatch.setattr(sys, "executable", os.fspath(tmp_path / "no-python"))
    with pytest.raises(OSError if no_process else ConfigError):
        PlannerProcess("serve" if no_process else "serve 'me", "a test")
    assert list(tmp_path.iterdir()) == []
