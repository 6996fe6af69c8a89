"""The planner in C++ builds, drives, and repeats itself."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import advdiff, bytes_of

SOURCE = Path(__file__).parents[2] / "examples/cpp_planner"
NEEDED = ("cmake", "g++", "protoc", "grpc_cpp_plugin", "pkg-config")
MISSING = [name for name in NEEDED if shutil.which(name) is None]


@pytest.mark.slow
@pytest.mark.skipif(
    bool(MISSING), reason=f"not installed: {', '.join(MISSING)} (.ci/run has Debian's packages)"
)
def test_the_planner_in_cpp_drives_along_its_lane(tmp_path: Path) -> None:
    build = tmp_path / "build"
    subprocess.run(["cmake", "-S", str(SOURCE), "-B", str(build)], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", str(build)], check=True, capture_output=True)
    words = ("run", "--target", f"exec:{build}/cpp_planner", "--episodes", 2, "--horizon", 8)
    for out in ("one", "two"):
        done = advdiff(*words, "--out", out, cwd=tmp_path)
        assert done.code == 0, done.err
    assert bytes_of(tmp_path / "one") == bytes_of(tmp_path / "two")
    for row in pq.read_table(tmp_path / "one/episodes.parquet").to_pylist():
        assert row["end"] != "failed", row["failure_message"]
        assert row["collision_type"] != "off_road"
        assert row["route_progress_m"] > 10.0
