"""Targets in separate processes, as a user starts them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import TINY, Outcome, advdiff, begin, bytes_of
from tests.e2e.conftest import sentence

SERVER = """
import os
import sys

import numpy as np

from advdiff_sumo.planner_kit import Controls, serve


class Wobbles:
    def start(self, road, scene, rng):
        return None

    def plan(self, road, scene, memory, rng):
        if "raises" in sys.argv:
            raise ValueError("no way found")
        if "nan" in sys.argv:
            print("the solver diverged", flush=True)
            return Controls(np.full(10, np.nan), np.zeros(10), 0.1), memory
        return Controls(rng.normal(0.0, 0.3, 10), np.zeros(10), 0.1), memory


with open("servers", "a") as file:
    file.write(f"{os.getpid()}\\n")
serve(Wobbles)
"""
RUN = ("run", "--net", "grid.net.xml", "--episodes", 2, *TINY)
COMMAND = f"exec:{sys.executable} our_server.py"


def gone(folder: Path) -> bool:
    """Return whether all servers that are noted in *folder* end."""
    pids = [int(line) for line in (folder / "servers").read_text().split()]
    assert pids
    for pid in pids:
        while Path(f"/proc/{pid}").exists():
            time.sleep(0.02)
    return True


@pytest.mark.slow
def test_a_command_is_started_for_the_run_and_ended_with_it(workplace: Path) -> None:
    (workplace / "our_server.py").write_text(SERVER)
    for out in ("one", "two"):
        done = advdiff(*RUN, "--target", COMMAND, "--out", out, cwd=workplace)
        assert done.code == 0, done.err
        assert done.err == ""
    assert bytes_of(workplace / "one") == bytes_of(workplace / "two")
    row = pq.read_table(workplace / "one" / "episodes.parquet").to_pylist()[0]
    assert row["end"] != "failed"
    assert gone(workplace)


def test_a_remote_planner_that_raises_is_a_failure_with_its_traceback(
    here: Callable[..., Outcome], workplace: Path
) -> None:
    (workplace / "our_server.py").write_text(SERVER)
    done = here(*RUN, "--target", f"{COMMAND} raises", "--out", "run")
    assert done.code == 1, done.err  # every episode failed
    rows = pq.read_table(workplace / "run" / "episodes.parquet").to_pylist()
    assert [row["failure_kind"] for row in rows] == ["planner_error"] * 2
    assert "ValueError: no way found" in rows[0]["failure_message"]
    failure = pq.read_table(workplace / "run" / "failures.parquet").to_pylist()[0]
    assert failure["log_tail"].startswith("Traceback (most recent call last):")
    assert failure["log_tail"].strip().endswith("ValueError: no way found")
    assert "no way found" in (workplace / "run" / "report.html").read_text()
    assert gone(workplace)


def test_what_a_planner_wrote_before_a_refused_plan_is_kept(
    here: Callable[..., Outcome], workplace: Path
) -> None:
    (workplace / "our_server.py").write_text(SERVER)
    done = here(*RUN, "--episodes", 1, "--target", f"{COMMAND} nan", "--out", "run")
    assert "the solver diverged" in done.err
    (failure,) = pq.read_table(workplace / "run" / "failures.parquet").to_pylist()
    assert failure["kind"] == "plan_refused"
    assert failure["log_tail"] == "the solver diverged"
    assert "the solver diverged" in (workplace / "run" / "report.html").read_text()


def test_a_run_that_is_killed_leaves_no_server(workplace: Path) -> None:
    (workplace / "our_server.py").write_text(SERVER)
    process = begin(*RUN, "--episodes", 1000, "--target", COMMAND, "--out", "run", cwd=workplace)
    while not list(workplace.glob("run/parts/*")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert gone(workplace)


@pytest.mark.slow
def test_a_server_at_an_address(here: Callable[..., Outcome], workplace: Path) -> None:
    (workplace / "our_server.py").write_text(SERVER)
    address = f"unix:{workplace}/socket"
    env = {**os.environ, "ADVDIFF_PLANNER_ADDRESS": address}
    with subprocess.Popen([sys.executable, "our_server.py"], cwd=workplace, env=env) as server:
        while not (workplace / "socket").exists():
            time.sleep(0.02)
        done = here(*RUN, "--target", f"grpc://{address}", "--out", "run")
        server.terminate()
    assert done.code == 0, done.err
    said = sentence(here(*RUN, "--target", f"grpc://{address}", "--out", "again"))
    assert "no server answered Describe; start it first" in said
    assert not (workplace / "again").exists()


def test_the_kit_is_written_once(here: Callable[..., Outcome], workplace: Path) -> None:
    done = here("planner-kit", "kit")
    assert done.code == 0, done.err
    assert (workplace / "kit/advdiff_sumo/planner_kit/planner.proto").exists()
    assert "is there already" in sentence(here("planner-kit", "kit"))
