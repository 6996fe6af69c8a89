"""The C++ planner can be built, drives, and is repeatable."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.examples.driven_twice import driven_twice

SOURCE = Path(__file__).parents[2] / "examples/cpp_planner"
NEEDED = ("cmake", "g++", "protoc", "grpc_cpp_plugin", "pkg-config")
MISSING = [name for name in NEEDED if shutil.which(name) is None]


@pytest.mark.slow
@pytest.mark.skipif(
    bool(MISSING), reason=f"not installed: {', '.join(MISSING)} (.ci/run has Debian's packages)"
)
def test_the_planner_in_cpp_drives_along_its_lane(tmp_path: Path) -> None:
    build = tmp_path / "build"
    # without optimisation and debug information, and with one read of gRPC's headers, compiling takes half as long
    fast_build = ("-DCMAKE_BUILD_TYPE=None", "-DCMAKE_UNITY_BUILD=ON")
    subprocess.run(["cmake", "-S", SOURCE, "-B", build, *fast_build], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", build], check=True, capture_output=True)
    driven = driven_twice(f"exec:{build}/cpp_planner", 8, folder=tmp_path)
    assert driven.first == driven.again
    assert driven.unsound(10.0) == []
