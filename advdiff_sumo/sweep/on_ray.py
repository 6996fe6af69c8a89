"""Execute tasks on a Ray cluster: the same tasks and outcomes, on several machines."""

from __future__ import annotations

import atexit
import hashlib
import importlib
import math
import os
import shutil
import socket
import tempfile
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import ConfigError, MissingExtraError, first_line
from advdiff_sumo.maps.shipped_nets import shipped_networks
from advdiff_sumo.sweep.sweep_files import write_whole
from advdiff_sumo.sweep.tasks import CallTask, Failed, Outcome, Task, WorkerLimits
from advdiff_sumo.sweep.worker_sandbox import bound_memory, outcome_of_dead_worker, run_sandboxed

_CONNECT_S = 10.0


class RayExecutor(AbstractContextManager["RayExecutor"]):
    """Workers of a Ray cluster, or of a local one that is started here.

    Nets are sent with the tasks. Demand files, driving logs and users' planners must be on every machine.
    """

    def __init__(
        self, address: str | None, workers: int | None, limits: WorkerLimits, nets: tuple[Path, ...]
    ) -> None:
        """Store the settings; nothing starts before ``with``.

        Args:
            address: HOST:PORT or "auto"; None: start Ray on this machine.
            workers: number of simultaneous tasks; None: one a core of the cluster.
            limits: limits of a worker.
            nets: net files that other machines may lack.

        Raises:
            MissingExtraError: Ray is not installed.
        """
        self._ray = _import_ray()
        self.address, self.limits, self.nets = address, limits, nets
        self.slots = workers or 1
        self._count_cores = workers is None
        self._running: dict[Any, Task] = {}
        self._remote_task: Any = None
        self._net_files: Any = None

    def __enter__(self) -> RayExecutor:
        """Connect to the cluster, or start one.

        Raises:
            ConfigError: the cluster cannot be reached.
        """
        ray = self._ray
        local: dict[str, Any] = {} if self.address else {"num_cpus": self.slots, "include_dashboard": False}
        _must_be_reachable(self.address)
        try:
            ray.init(self.address, log_to_driver=False, logging_level="error", **local)
        except Exception as error:  # noqa: BLE001 - Ray also raises plain exceptions
            where = f"--ray-address {self.address}" if self.address else "--executor ray"
            raise ConfigError(f"{where}: no cluster ({first_line(error)}); see docs/sweeps.md") from None
        if self._count_cores:
            self.slots = max(1, int(ray.cluster_resources().get("CPU", 1)))
        assets = {str(path): path.read_bytes() for path in self.nets if path.parent != shipped_networks()}
        self._net_files = ray.put(assets)
        self._remote_task = ray.remote(num_cpus=1, max_retries=0, max_calls=self.limits.tasks)(on_worker)
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Disconnect from the cluster; running tasks are cancelled after an error."""
        if kind is not None:
            for reference in self._running:
                self._ray.cancel(reference, force=True)
        self._ray.shutdown()

    def submit(self, task: Task) -> None:
        """Pass *task* to the cluster."""
        self._running[self._remote_task.remote(task, self.limits, self._net_files)] = task

    def wait(self) -> Outcome:
        """Wait for any task, and return its outcome."""
        (reference,), _ = self._ray.wait(list(self._running), num_returns=1)
        task = self._running.pop(reference)
        try:
            outcome: Outcome = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            return Outcome(task.key, (), Failed("error", first_line(error), str(error)))
        except self._ray.exceptions.RayError as error:  # the worker or its machine is lost
            return outcome_of_dead_worker(task, self.limits, None, f"was lost ({type(error).__name__})")
        return outcome


def on_worker(task: Task, limits: WorkerLimits, assets: Mapping[str, bytes]) -> Outcome:
    """Perform *task* on a worker of a cluster, where net files may be missing or elsewhere."""
    bound_memory(limits.memory_mb)
    limits.logs.mkdir(parents=True, exist_ok=True)
    net = "" if isinstance(task, CallTask) else task.options.net
    if not isinstance(task, CallTask) and net in assets and not _holds(Path(net), assets[net]):
        local_net = str(_unpacked_net(Path(net), assets))
        task = replace(task, options=task.options.model_copy(update={"net": local_net}))
    return run_sandboxed(task, replace(limits, recycle_share=math.inf))  # Ray replaces its workers itself


def _must_be_reachable(address: str | None) -> None:
    """Check that a server listens at *address*; Ray itself would retry for minutes.

    Raises:
        ConfigError: no connection within ten seconds.
    """
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if not (host and port.isdigit()):
        return  # no address, or "auto"
    try:
        socket.create_connection((host, int(port)), timeout=_CONNECT_S).close()
    except (OSError, OverflowError) as error:
        reason = f"nobody answers ({first_line(error)})"
        raise ConfigError(f"--ray-address {address}: no cluster, {reason}; see docs/sweeps.md") from None


def _holds(path: Path, content: bytes) -> bool:
    """Return whether *path* has this *content*."""
    try:
        return path.read_bytes() == content
    except OSError:
        return False


def _unpacked_net(net: Path, assets: Mapping[str, bytes]) -> Path:
    """Write *net* and its drivable area to a temporary folder of this machine; return the net's path there."""
    contents = {
        Path(name).name: content for name, content in assets.items() if Path(name).parent == net.parent
    }
    joined = b"".join(contents[name] for name in sorted(contents))
    folder = Path(
        tempfile.gettempdir(), f"advdiff-nets-{hashlib.sha256(joined).hexdigest()[:16]}-{os.getpid()}"
    )
    folder.mkdir(exist_ok=True)
    for name, content in contents.items():
        if not _holds(folder / name, content):
            write_whole(folder / name, content)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder / net.name


def _import_ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise MissingExtraError("--executor ray", "ray") from None
