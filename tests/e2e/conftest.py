"""Nets, planners and finished runs for tests of the commands."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import sumolib

from advdiff_sumo.cli.main import main
from tests.e2e.commands import TINY, Outcome, advdiff, everything

PLANNERS = """
import time
from pathlib import Path

import numpy as np

from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.planners.lane_graph import LaneGraphPlanner


class Patient(LaneGraphPlanner):
    "Drives like lane_graph; from the third episode on it waits while a file named hold is there."

    def start(self, road, scene, rng):
        with Path("starts").open("a") as starts:  # parts may be stored late
            starts.write(".")
        while Path("hold").exists() and len(Path("starts").read_text()) > 2:
            time.sleep(0.01)
        return super().start(road, scene, rng)


class Still:
    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        xy, yaw = scene.history.xy_m[scene.target, -1], scene.history.yaw_rad[scene.target, -1]
        return Trajectory(self.spoil(np.tile(xy, (20, 1))), np.full(20, yaw), np.zeros(20), 0.1), None


class Raises(Still):
    def spoil(self, xy):
        raise RuntimeError("out of ideas")


class NotANumber(Still):
    def spoil(self, xy):
        xy[3] = np.nan
        return xy


class Jumps(Still):
    def spoil(self, xy):
        xy[3:] += 50.0
        return xy


class Nothing:
    pass


class Broken:
    def __init__(self):
        raise RuntimeError("no weights found")
"""


@pytest.fixture(scope="session")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a net of nine junctions with two-lane streets."""
    net = tmp_path_factory.mktemp("grid") / "grid.net.xml"
    shape = ["--grid", "--grid.number", "3", "--grid.length", "100", "--grid.attach-length", "100"]
    command = [sumolib.checkBinary("netgenerate"), *shape, "--default.lanenumber", "2", "-o", str(net)]
    subprocess.run(command, check=True, capture_output=True)
    return net


@pytest.fixture
def workplace(tmp_path: Path, grid: Path) -> Path:
    """Return a folder with a net and a user's planners."""
    (tmp_path / "grid.net.xml").write_bytes(grid.read_bytes())
    (tmp_path / "our_planners.py").write_text(PLANNERS)
    return tmp_path


@pytest.fixture
def here(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Outcome]:
    """Return a function that runs a command in the workplace, in this process, since new ones take seconds to start."""
    monkeypatch.chdir(workplace)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p != str(workplace)])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.delitem(sys.modules, "our_planners", raising=False)

    def run(*words: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["advdiff-sumo", *map(str, words)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as exit_info:
            main()
        out, err = capsys.readouterr()
        code = exit_info.value.code
        return Outcome(code if isinstance(code, int) else 0, out, err)

    yield run
    sys.modules.pop("our_planners", None)


@pytest.fixture
def refused(here: Callable[..., Outcome], workplace: Path) -> Callable[..., str]:
    """Return a function that runs a command, checks that it is refused and changes no file, and returns the error."""

    def run(*words: object) -> str:
        before = everything(workplace)
        outcome = here(*words)
        assert everything(workplace) == before
        return sentence(outcome)

    return run


def sentence(outcome: Outcome) -> str:
    """Return the error message of a refused command, which must be one line."""
    assert outcome.code == 2, outcome
    assert "Traceback" not in outcome.err + outcome.out
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("error: ")
    return lines[0]


@pytest.fixture(scope="session")
def downtown_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a tiny run on the shipped downtown."""
    folder = tmp_path_factory.mktemp("downtown")
    done = advdiff("run", "--episodes", 2, *TINY, "--out", "first", cwd=folder)
    assert done.code == 0, done.err
    (folder / "said.txt").write_text(done.out)
    return folder / "first"
