"""Ray: the same bytes, also if a machine of the cluster is lost."""

from __future__ import annotations

import importlib.util
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import tomli_w

from advdiff_sumo.sweep.sweep_store import Store
from tests.e2e.commands import advdiff, begin
from tests.hang_guard import HANG_S
from tests.sweep.conftest import bytes_of, planned, serially, values

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra ray is not installed"),
]
RAY = str(Path(sys.executable).parent / "ray")
QUICK = {"RAY_health_check_failure_threshold": "2", "RAY_health_check_period_ms": "1000"}


@pytest.fixture
def token(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray requires a token of all that join a cluster: one for this cluster only."""
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    monkeypatch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))


@pytest.fixture
def nodes(token: None) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Two nodes of one core each on this machine, started by two calls of ``ray start``."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    room = Path(tempfile.mkdtemp(prefix="r", dir="/tmp"))
    first = ["--head", f"--port={address.split(':')[1]}", "--include-dashboard=false", f"--temp-dir={room}"]
    started: list[subprocess.Popen[bytes]] = []
    try:
        for words in (first, [f"--address={address}"]):
            command = [RAY, "start", *words, "--num-cpus=1", "--object-store-memory=80000000", "--block"]
            process = subprocess.Popen(
                [*command, "--disable-usage-stats"],
                env=os.environ | QUICK,
                start_new_session=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
            started.append(process)
            _wait_for_line(process, b"--block")
        yield address, started
    finally:
        for process in reversed(started):
            _end(process, signal.SIGKILL)
        shutil.rmtree(room, ignore_errors=True)


def test_a_sweep_survives_the_loss_of_one_of_two_nodes(
    place: Path, nodes: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    address, (_, second) = nodes
    grid = {"nets": [str(place / "small.net.xml")], "targets": ["IDM", "Krauss"], "backgrounds": ["replay"]}
    asked = values(place, grid=grid, episodes=6)
    (tmp_path / "asked.toml").write_text(tomli_w.dumps(asked))
    undisturbed = serially(planned(place, grid=grid, episodes=6), tmp_path / "serial")
    words = ("--executor", "ray", "--ray-address", address, "--retries", 5, "--out", "s")
    process = begin("sweep", "asked.toml", *words, cwd=tmp_path)
    until = time.monotonic() + HANG_S
    while sum(path.is_file() for path in (tmp_path / "s" / "episodes").rglob("*")) < 3:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.05)
    _end(second, signal.SIGKILL)
    out, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 0, out + err
    assert bytes_of(Store.open(tmp_path / "s")) == bytes_of(undisturbed)


def test_a_missing_cluster_is_one_sentence(place: Path, tmp_path: Path) -> None:
    grid = {"nets": [str(place / "small.net.xml")], "targets": ["IDM"], "backgrounds": ["replay"]}
    (tmp_path / "asked.toml").write_text(tomli_w.dumps(values(place, grid=grid)))
    words = ("--executor", "ray", "--ray-address", "127.0.0.1:1", "--out", "s")
    done = advdiff("sweep", "asked.toml", *words, cwd=tmp_path)
    assert done.code == 2
    assert done.err.splitlines()[-1].startswith(
        "error: --ray-address 127.0.0.1:1: no cluster, nobody answers ("
    )
    assert "Traceback" not in done.out + done.err


def _wait_for_line(process: subprocess.Popen[bytes], words: bytes) -> None:
    assert process.stdout is not None
    said = b""
    for line in process.stdout:
        said += line
        if words in line:
            return
    pytest.fail(f"ray start ended with {process.wait()}: {said.decode()[-500:]}")


def _end(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    if process.poll() is None:
        os.killpg(process.pid, number)
        process.wait(timeout=HANG_S)
    if process.stdout is not None:
        process.stdout.close()
