"""How a worker reports what goes wrong in it."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from advdiff_sumo.sim.heartbeat import Heartbeat, ProcessPhase
from advdiff_sumo.sim.run_episodes import RunOptions
from advdiff_sumo.sweep import tasks
from advdiff_sumo.sweep.consolidate import read_rows
from advdiff_sumo.sweep.executors import ProcessExecutor
from advdiff_sumo.sweep.sweep_runner import RemainingJobs, open_store, run_sweep
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.tasks import CallTask, EpisodeTask, WorkerLimits
from advdiff_sumo.sweep.work import perform
from advdiff_sumo.sweep.worker_sandbox import outcome_of_dead_worker
from tests.sweep.conftest import planned


def lacking() -> bytes:
    raise MemoryError("17 GB")


def filling() -> bytes:
    return bytes(torch.empty(10**15))  # four petabytes, more than a process can address


@pytest.mark.parametrize(("call", "words"), [(lacking, "17 GB"), (filling, "can't allocate memory")])
def test_a_worker_without_memory_reports_it_whatever_code_needed_it(
    call: Callable[[], bytes], words: str
) -> None:
    failed = perform(CallTask("k", call)).failed
    assert failed is not None
    assert failed.kind == "out_of_memory"
    assert failed.message.startswith("the worker ran out of memory: ")
    assert words in failed.message
    assert "Traceback" in failed.log_tail


WELL_HERE = '''
import os
import time
from multiprocessing import parent_process

from advdiff_sumo.traffic.sumo_traffic import SumoTraffic


def leaves():
    os._exit(3)


def hangs():
    while True:
        time.sleep(0.01)


class Planner:
    """Made in the process that checks the sweep, and in no worker."""

    def __init__(self, deed):
        if parent_process() is not None:
            globals()[deed]()

    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        raise NotImplementedError


class Traffic(SumoTraffic):
    """The same for a background."""

    def __init__(self, deed):
        Planner.__init__(self, deed)
        super().__init__()
'''


@pytest.fixture
def well_here(place: Path) -> Iterator[Path]:
    (place / "well_here.py").write_text(WELL_HERE)
    yield place
    sys.modules.pop("well_here", None)


def swept(place: Path, limits: WorkerLimits, folder: Path, **grid: Any) -> Store:
    """Return the store of a sweep of two episodes; each is retried once if its worker dies."""
    base = {"nets": [str(place / "small.net.xml")], "targets": ["IDM"], "backgrounds": ["sumo"]}
    plan = planned(place, grid=base | grid)
    store = open_store(folder, plan, 1, resume=False)
    assert (
        run_sweep(plan, store, RemainingJobs.of(plan, store), ProcessExecutor(1, limits), 1, lambda *_: None)
        == 0
    )
    return store


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "name", "who"),
    [("targets", "Planner", "target"), ("backgrounds", "Traffic", "background")],
)
def test_a_driver_that_ends_the_process_while_it_is_made_costs_its_episodes_only(
    well_here: Path, limits: WorkerLimits, tmp_path: Path, part: str, name: str, who: str
) -> None:
    choice = {"name": f"well_here:{name}", "options": {"deed": "leaves"}}
    store = swept(well_here, limits, tmp_path / "s", **{part: [choice]})
    words = f"{who} 'well_here:{name}' ended its process while it was made: the worker ended with exit code 3"
    failures = read_rows(store.path, "failures")
    assert [(row["kind"], row["message"], row["attempts"]) for row in failures] == [
        ("planner_crashed", words, 2)
    ] * 2
    rows = read_rows(store.path, "episodes")
    assert [(row["end"], row["failure_message"], row["duration_s"]) for row in rows] == [
        ("failed", words, 0.0)
    ] * 2


@pytest.mark.slow
def test_a_driver_that_hangs_while_it_is_made_is_ended(
    well_here: Path, limits: WorkerLimits, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tasks, "STEP_TIMEOUT_S", 3.0)  # the only limit in this sweep
    brief = WorkerLimits(math.inf, limits.memory_mb, 100, 0.9, limits.logs, plan_timeout_s=2.0)
    choice = {"name": "well_here:Planner", "options": {"deed": "hangs"}}
    store = swept(well_here, brief, tmp_path / "s", targets=[choice])
    failures = read_rows(store.path, "failures")
    assert [row["kind"] for row in failures] == ["planner_timeout"] * 2
    for row in failures:
        assert row["message"].startswith(
            "target 'well_here:Planner' was not made in 3 s (well_here.py, line "
        )
        assert "in hangs" in row["log_tail"]
    assert [row["end"] for row in read_rows(store.path, "episodes")] == ["failed"] * 2


def test_how_long_each_phase_may_last(limits: WorkerLimits) -> None:
    """Making a planner has the same limit as a step of SUMO, even if plans have a shorter one."""
    for plan_s, longest_s in ((2.0, 300.0), (400.0, 400.0), (math.inf, math.inf)):
        own = WorkerLimits(math.inf, 0, 1, 0.9, limits.logs, plan_timeout_s=plan_s)
        assert {phase: own.longest_s(phase) for phase in ProcessPhase} == {
            ProcessPhase.OTHER: math.inf,
            ProcessPhase.SIMULATOR: longest_s,
            ProcessPhase.TARGET: plan_s,
            ProcessPhase.BACKGROUND: plan_s,
            ProcessPhase.MAKING_TARGET: longest_s,
            ProcessPhase.MAKING_BACKGROUND: longest_s,
        }


@pytest.mark.parametrize(
    ("phase", "words"),
    [
        (
            ProcessPhase.MAKING_BACKGROUND,
            "background 'mine:B' ended its process while it was made: the worker left",
        ),
        (
            ProcessPhase.BACKGROUND,
            "background 'mine:B' ended its process before the first step: the worker left",
        ),
    ],
)
def test_the_message_for_a_worker_lost_before_the_first_step(
    limits: WorkerLimits, phase: ProcessPhase, words: str
) -> None:
    task = EpisodeTask("k", RunOptions(background="mine:B"), 0, b"", "")
    Heartbeat(limits.heartbeat_of("k")).note(phase)
    failed = outcome_of_dead_worker(task, limits, 3, "left").failed
    assert failed is not None
    assert (failed.kind, failed.message) == ("planner_crashed", words)
