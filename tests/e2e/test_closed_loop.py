"""``tools/check_closed_loop.py``: collisions are repeated with a careful driver in the target's place."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import Outcome

TOOL = Path(__file__).resolve().parents[2] / "tools" / "check_closed_loop.py"


def checked(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, TOOL, folder, *options]
    return subprocess.run(command, check=False, capture_output=True, text=True)


@pytest.mark.slow
def test_collisions_of_a_run(tmp_path: Path, here: Callable[..., Outcome]) -> None:
    """A planner that sees only 2 m ahead runs into others; the driver that takes over seconds before does not."""
    out = tmp_path / "run"
    asked = ["--target", "lane_graph", "--defect", "range:2", "--episodes", "2", "--horizon", "15"]
    asked += ["--set", "scene.density_per_km=20", "--set", "scene.warmup_s=20", "--out", out]
    assert here("run", *asked).code == 0
    hits = pq.read_table(out / "episodes.parquet")["collision_partner"]
    count = len(hits) - hits.null_count
    assert count > 0
    done = checked(out, "--collisions", "2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{min(count, 2)} collisions")
    same = checked(out, "--driver", "same", "--collisions", "1", "--differences")
    assert same.returncode == 0, same.stderr
    assert "agreement" in same.stdout


def test_what_cannot_be_run_again(tmp_path: Path) -> None:
    done = checked(tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("check_closed_loop: ")
