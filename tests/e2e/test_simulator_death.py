"""Runs in which libsumo crashes and ends the process."""

from __future__ import annotations

import signal
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import TINY, Outcome, advdiff

# docs/sumo.md, "Beside the lane": SUMO reads freed memory in a step soon after the second position
PLANNER = '''
import libsumo
import numpy as np

from advdiff_sumo.core.plan import Controls

PLACES = {10: (854.819, 208.395, 105.67), 11: (855.933, 208.049, 107.25)}


class Meddler:
    """Coasts, and moves a vehicle beside its lane without the simulation's knowledge."""

    def start(self, road, scene, rng):
        return 0

    def plan(self, road, scene, memory, rng):
        if memory == 10:
            libsumo.route.add("r", ["H3f-H3.1"])
            for name in ("ahead", "beside"):
                libsumo.vehicle.add(name, "r")
        if memory in PLACES:
            libsumo.vehicle.moveToXY("beside", "", -1, *PLACES[memory], 3)
        return Controls(np.zeros(10), np.zeros(10), 0.1), memory + 1
'''


@pytest.fixture(scope="module")
def dead(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """Return the working folder and the outcome of a run whose only episode crashed libsumo."""
    place = tmp_path_factory.mktemp("dead")
    (place / "meddler.py").write_text(PLANNER)
    (place / "tmp").mkdir()
    words = ("run", "--target", "meddler:Meddler", "--background", "replay", "--episodes", 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(place / "tmp"))
        done = advdiff(*words, *TINY, "--set", "sim.model_step_s=0.1", "--out", "run", cwd=place)
    return place, done


def test_a_crash_of_libsumo_is_a_failure_with_its_steps_and_command(dead: tuple[Path, Outcome]) -> None:
    place, done = dead
    assert done.code == 1, done.err  # its only episode failed
    assert "Traceback" not in done.out + done.err
    (row,) = pq.read_table(place / "run" / "episodes.parquet").to_pylist()
    assert (row["end"], row["failure_kind"]) == ("failed", "simulator_crashed")
    states = pq.read_table(place / "run" / "states.parquet").to_pylist()
    steps = sorted(state["step"] for state in states if state["is_target"])
    assert steps == list(range(len(steps)))
    assert len(steps) > 11  # the vehicle is moved from the step after 1.0 s on
    told = f"SUMO crashed at {0.1 * steps[-1]:.1f} s of the episode: the worker was ended by SIGSEGV"
    assert row["failure_message"] == told
    assert row["duration_s"] == pytest.approx(0.1 * steps[-1])
    assert (
        f"failed, 1 of 1: simulator_crashed: {told}\n  again: advdiff-sumo replay 0 --run run\n" in done.out
    )
    assert "neither a plug-in nor the input explains this: please report it" in done.out


def test_it_leaves_no_temporary_files(dead: tuple[Path, Outcome]) -> None:
    place, _ = dead
    assert list((place / "tmp").iterdir()) == []


@pytest.mark.slow
def test_its_command_brings_the_crash_to_a_debugger(dead: tuple[Path, Outcome]) -> None:
    place, _ = dead
    again = advdiff("replay", 0, "--run", "run", "--out", "again", cwd=place)
    assert again.code == -signal.SIGSEGV
