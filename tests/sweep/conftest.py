"""A tiny net, planners with every fault, and the results of a sweep when nothing fails."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sumolib

from advdiff_sumo.sweep.consolidate import read_rows
from advdiff_sumo.sweep.executors import SerialExecutor
from advdiff_sumo.sweep.job_plan import SweepPlan, plan_sweep
from advdiff_sumo.sweep.spec import SweepSpec
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import WorkerLimits

SAME_BYTES = tuple(f"{name}.parquet" for name in ("episodes", "collisions", "states", "plans", "unattacked"))

PLANNERS = '''
import time
from pathlib import Path

import numpy as np

from advdiff_sumo.core.plan import Controls


class Coasts:
    """Keeps its speed; has its fault as long as the file "ill" exists."""

    def __init__(self, fault="none", beside="."):
        self.fault, self.flag = fault, Path(beside) / "ill"

    def start(self, road, scene, rng):
        return []

    def plan(self, road, scene, memory, rng):
        if self.flag.exists():
            getattr(self, self.fault)(memory)
        accel = np.full(10, float(rng.normal(0.0, 0.1)))
        if self.fault == "nan":
            accel[4] = np.nan
        return Controls(accel, np.zeros(10), dt_s=0.1), memory

    def none(self, memory):
        pass

    nan = none

    def raises(self, memory):
        raise RuntimeError("out of ideas")

    def hangs(self, memory):
        print("thinking", flush=True)
        while True:
            time.sleep(0.01)

    def eats(self, memory):
        while True:
            memory.append(np.ones(8_000_000))

    def segfaults(self, memory):
        import libsumo

        print("requests.Timeout (5 s)", flush=True)  # not what Python prints at a time limit
        libsumo.vehicle.add("ghost", libsumo.route.getIDList()[0], depart="100000")
        libsumo.vehicle.moveToXY("ghost", "", -1, -5000.0, -5000.0, 0.0, 2)
        libsumo.simulationStep()
        libsumo.vehicle.getRoadID("ghost")
        libsumo.vehicle.getNeighbors("ghost", 2)

    def exits(self, memory):
        raise SystemExit(3)
'''


@pytest.fixture(scope="session")
def sweep_grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A net of four junctions with one-lane streets."""
    net = tmp_path_factory.mktemp("sweep-grid") / "small.net.xml"
    shape = ["--grid", "--grid.number", "2", "--grid.length", "120", "--grid.attach-length", "120"]
    command = [sumolib.checkBinary("netgenerate"), *shape, "--default.lanenumber", "1", "-o", str(net)]
    subprocess.run(command, check=True, capture_output=True)
    return net


@pytest.fixture(scope="session")
def place(sweep_grid: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the net and the planners, importable."""
    folder = tmp_path_factory.mktemp("sweeps")
    (folder / "small.net.xml").write_bytes(sweep_grid.read_bytes())
    (folder / "sick_planners.py").write_text(PLANNERS)
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))
    sys.modules.pop("sick_planners", None)


def values(place: Path, faults: tuple[str, ...] = ("none",), **more: Any) -> dict[str, Any]:
    """Return the content of a sweep file: two seed scenes of three seconds for each planner."""
    targets = [
        {"name": "sick_planners:Coasts", "options": {"fault": fault, "beside": str(place)}}
        for fault in faults
    ]
    content = {
        "episodes": 2,
        "horizon_s": 3.0,
        "scene": {"warmup_s": 8.0, "scenes_per_warmup": 2, "min_neighbours": 1, "min_route_m": 60.0},
        "grid": {"nets": [str(place / "small.net.xml")], "targets": targets, "backgrounds": ["replay"]},
    }
    return content | more


def planned(place: Path, faults: tuple[str, ...] = ("none",), **more: Any) -> SweepPlan:
    """Return the plan of :func:`values`."""
    return plan_sweep(SweepSpec.of(values(place, faults, **more), "test"))


def serially(plan: SweepPlan, folder: Path) -> Store:
    """Run a sweep in this process."""
    store = open_store(folder, plan, 1, resume=False)
    assert run_sweep(plan, store, RemainingJobs.of(plan, store), SerialExecutor(), 0, lambda *_: None) == 0
    return store


def bytes_of(store: Store) -> dict[str, object]:
    """Return the tables that do not depend on the machine; failures without attempts and command."""
    failures = read_rows(store.path, "failures")
    told = [{k: v for k, v in row.items() if k not in {"attempts", "command"}} for row in failures]
    return {"failures": told, **{name: (store.path / name).read_bytes() for name in SAME_BYTES}}


@pytest.fixture
def limits(tmp_path: Path) -> WorkerLimits:
    """Limits of a worker."""
    logs = tmp_path / "logs"
    logs.mkdir()
    return WorkerLimits(timeout_s=600.0, memory_mb=2000, tasks=100, recycle_share=0.9, logs=logs)
