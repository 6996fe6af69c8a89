"""A script that calls ``ads.sweep`` without ``if __name__ == "__main__":``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.hang_guard import HANG_S

SCRIPT = """
import advdiff_sumo as ads

grid = {"nets": ["downtown"], "targets": ["IDM"], "backgrounds": ["sumo"]}
ads.sweep({"episodes": 1, "horizon_s": 1.0, "grid": grid}, workers=1, progress=False)
"""


def test_workers_start_no_sweeps_and_name_the_missing_line(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=HANG_S,
    )
    assert 'call it below if __name__ == "__main__":' in done.stderr
    assert len(list((tmp_path / "runs").iterdir())) == 1
