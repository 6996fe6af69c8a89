"""A planner with every fault, in a folder of its own, and its server as a target."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.remote.remote_planner import RemotePlanner, remote_planner
from tests.planners.scenes import Car, make_scene

FAULTY = '''
import ctypes
import subprocess
import sys
import time

import numpy as np

from advdiff_sumo.planner_kit import Controls, serve

CHILD = "import time; time.sleep(600)"


class PanicException(BaseException):
    """As that of pyo3 is."""


class Faulty:
    """Accelerates by a number that it draws and by the lanes that it knows; has the fault that its word names."""

    def __init__(self, fault=""):
        self.fault = fault

    def start(self, road, scene, rng):
        if self.fault == "child":
            subprocess.Popen([sys.executable, "-c", CHILD, "left-behind by " + __file__], start_new_session=True)
        return [len(road.lanes), road.lanes["west_in_0"].speed_mps, 0]

    def plan(self, road, scene, memory, rng):
        memory[2] += 1
        accel = np.full(10, rng.normal() + 0.001 * memory[0] + 0.1 * memory[2])
        if memory[2] == 2:
            getattr(self, self.fault, lambda *_: None)(accel)
        if self.fault == "returns":
            return {"accel": 1.0}, memory
        return Controls(accel, np.zeros(10), 0.1), memory

    def end(self, memory, end):
        print(f"ended: {end}", flush=True)

    def raises(self, accel):
        raise RuntimeError("out of ideas")

    def panics(self, accel):
        raise PanicException("called unwrap() on a None value")

    def interrupts(self, accel):
        raise KeyboardInterrupt("by itself")

    def eats(self, accel):
        raise MemoryError("too much")

    def fills(self, accel):
        raise RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 8 bytes")

    def nan(self, accel):
        accel[3] = np.nan

    def hangs(self, accel):
        print("thinking", flush=True)
        time.sleep(600)

    def segfaults(self, accel):
        ctypes.string_at(0)

    def exits(self, accel):
        sys.exit(3)


if __name__ == "__main__":
    serve(Faulty(*sys.argv[1:]))
'''


@pytest.fixture(scope="session")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The planner's file."""
    path = tmp_path_factory.mktemp("faulty") / "faulty_server.py"
    path.write_text(FAULTY)
    return path


@pytest.fixture
def served(faulty: Path) -> Iterator[Callable[..., RemotePlanner]]:
    """Return a maker of remote planners with a given fault; their servers end with the test."""
    made: list[RemotePlanner] = []

    def make(fault: str = "", **options: float) -> RemotePlanner:
        made.append(remote_planner(f"exec:{sys.executable} {shlex.quote(str(faulty))} {fault}", options))
        return made[-1]

    yield make
    for planner in made:
        planner.close()


@pytest.fixture
def road(crossing: Callable[..., RoadMap]) -> RoadMap:
    """A crossing."""
    return crossing()


@pytest.fixture
def scene(road: RoadMap) -> Scene:
    """Two cars on it; the second one was missing at the first instant."""
    made = make_scene(
        road, [Car("west_in_0", 80.0, 8.0), Car("east_in_0", 60.0, 9.0)], ("west_in", "east_out")
    )
    history = made.history
    for name in ("xy_m", "yaw_rad", "speed_mps"):
        getattr(history, name)[1, 0] = np.nan
    history.valid[1, 0] = False
    return made
