"""Ray: the same bytes, and a machine of the cluster may die in the middle."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.sweep.plan import Plan, needed_nets
from advdiff_sumo.sweep.run import Todo, open_store, run_sweep
from advdiff_sumo.sweep.tasks import Limits
from tests.sweep.conftest import bytes_of, planned, serially

pytest.importorskip("ray", reason="the extra ray is not installed")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore"),  # Ray's own, at import and when it leaves
]
RAY = str(Path(sys.executable).parent / "ray")
ENVIRONMENT = {**os.environ, "RAY_health_check_failure_threshold": "2", "RAY_health_check_period_ms": "1000"}


@pytest.fixture(scope="module")
def plan(place: Path) -> Plan:
    grid = {"nets": [str(place / "small.net.xml")], "targets": ["IDM", "Krauss"], "backgrounds": ["replay"]}
    return planned(place, grid=grid, episodes=6)


@pytest.fixture
def nodes() -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Two nodes of one core each on this machine, as two calls of ``ray start`` make them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    room = Path(tempfile.mkdtemp(prefix="r", dir="/tmp"))
    first = ["--head", f"--port={address.split(':')[1]}", "--include-dashboard=false", f"--temp-dir={room}"]
    started = []
    for words in (first, [f"--address={address}"]):
        command = [RAY, "start", *words, "--num-cpus=1", "--object-store-memory=80000000", "--block"]
        process = subprocess.Popen(
            [*command, "--disable-usage-stats"],
            env=ENVIRONMENT,
            start_new_session=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        started.append(process)
        _wait_for_line(process, b"--block")
    yield address, started
    for process in reversed(started):
        _end(process, signal.SIGKILL)
    shutil.rmtree(room, ignore_errors=True)


def test_one_of_two_nodes_is_killed_in_the_middle(
    plan: Plan,
    nodes: tuple[str, list[subprocess.Popen[bytes]]],
    limits: Limits,
    tmp_path: Path,
) -> None:
    from advdiff_sumo.sweep.on_ray import RayExecutor

    address, (_, second) = nodes
    undisturbed = serially(plan, tmp_path / "serial")
    store = open_store(tmp_path / "s", plan, 2, resume=False)
    told: list[object] = []

    def kill_a_node(*row: object) -> None:
        told.append(row)
        if len(told) == 3:
            _end(second, signal.SIGKILL)

    executor = RayExecutor(address, None, limits, needed_nets(plan))
    assert run_sweep(plan, store, Todo.of(plan, store), executor, 3, kill_a_node) == 0
    assert executor.slots == 2
    assert second.poll() is not None
    assert bytes_of(store) == bytes_of(undisturbed)


def test_a_cluster_that_is_not_there_is_one_sentence(plan: Plan, limits: Limits) -> None:
    from advdiff_sumo.sweep.on_ray import RayExecutor

    with (
        pytest.raises(ConfigError, match=r"--ray-address 127\.0\.0\.1:1: no cluster") as caught,
        RayExecutor("127.0.0.1:1", 1, limits, needed_nets(plan)),
    ):
        pass
    assert "\n" not in str(caught.value)


def _wait_for_line(process: subprocess.Popen[bytes], words: bytes) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if words in line:
            return
    pytest.fail(f"ray start ended with {process.wait()}")


def _end(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    if process.poll() is None:
        os.killpg(process.pid, number)
        process.wait(timeout=60)
    if process.stdout is not None:
        process.stdout.close()
