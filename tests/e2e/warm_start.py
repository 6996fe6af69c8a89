"""A process that has imported the modules of all commands and forks a process for each command.

A command that is started in this way behaves like one that is started normally: it has its own working folder,
environment, standard streams and exit code, waits for its threads and runs its exit functions. Only the seconds for
imports and their clean-up are saved. This file is also the script of that process.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import util
from pathlib import Path
from tempfile import TemporaryFile
from typing import NoReturn

#: Modules that commands and workers import, including slow ones that only some verbs need.
MODULES = (
    *("advdiff_sumo.cli.main", "advdiff_sumo.sim.run_episodes", "advdiff_sumo.sweep.executors"),
    *("advdiff_sumo.sweep.work", "advdiff_sumo.report.page", "scipy.signal", "torch"),
    *("pyarrow.dataset", "typer.rich_utils"),
    *("advdiff_sumo.experiments.bench.runner", "advdiff_sumo.sim.measured_conversion"),
    *("advdiff_sumo.experiments.judge_folder", "advdiff_sumo.experiments.warmup_run", "advdiff_sumo.export"),
    *("advdiff_sumo.training.setup", "advdiff_sumo.traffic.diffusion.diffusion_policy"),
)
#: PyTorch imports this with its first optimiser; it is rarely needed with another hash seed than 0.
_WITH_OPTIMISER = "torch._dynamo"
_REQUEST_BYTES = 1 << 20
_CLIENT = """#!{python} -IS
import json, os, socket, sys
warm = socket.socket(fileno={descriptor})
socket.send_fds(warm, [json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()], [1, 2])
sys.exit(int(warm.recv(64)))
"""
_MOST_DESCRIPTORS = 4096
_COLD = util.spawnv_passfds


class WarmStart:
    """Starts commands from one process, whose environment is *environment*."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.environment = environment
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno())],
                env=environment,
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )

    def run(
        self, words: list[str], cwd: Path, environment: dict[str, str], limit_s: float
    ) -> tuple[int, str, str]:
        """Run ``python -m advdiff_sumo`` with *words* and return its exit code, output and errors."""
        self._socket.settimeout(limit_s)
        with TemporaryFile() as out, TemporaryFile() as err:
            request = json.dumps([words, str(cwd), environment]).encode()
            socket.send_fds(self._socket, [request], [out.fileno(), err.fileno()])
            code = int(self._socket.recv(64))
            return code, _text(out.fileno()), _text(err.fileno())

    def write_program(self, folder: Path) -> None:
        """Write a program ``advdiff-sumo`` into *folder*; its shell must inherit ``descriptor``; one run at a time."""
        program = folder / "advdiff-sumo"
        program.write_text(
            _CLIENT.format(python=sys.executable, descriptor=self.descriptor), encoding="utf-8"
        )
        program.chmod(0o755)

    @property
    def descriptor(self) -> int:
        """Descriptor of the socket for requests."""
        return self._socket.fileno()

    def end(self) -> None:
        """End the process and all processes that hang in its session."""
        self._socket.close()
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def _text(descriptor: int) -> str:
    with os.fdopen(os.dup(descriptor), encoding="utf-8") as stream:
        stream.seek(0)
        return stream.read()


def _become_next_command(requests: socket.socket) -> None:
    """Serve requests; return only in the forked processes, each of which runs a command."""
    while True:
        request, streams, _, _ = socket.recv_fds(requests, _REQUEST_BYTES, 2)
        if not request:
            os._exit(0)
        child = os.fork()
        if child == 0:
            requests.close()
            _take_over(json.loads(request), streams)
            return
        for stream in streams:
            os.close(stream)
        requests.send(str(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])).encode())


def _take_over(request: tuple[list[str], str, dict[str, str]], streams: list[int]) -> None:
    """Set words, working folder, environment and streams of this process to those of a command."""
    words, cwd, environment = request
    for number, stream in zip((1, 2), streams, strict=True):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(environment)
    sys.path[0] = cwd
    sys.argv = ["advdiff-sumo", *words]
    util.spawnv_passfds = _fork_servers


def _fork_servers(program: bytes, words: list[str], kept: tuple[int, ...]) -> int:
    """Replace ``spawnv_passfds`` of multiprocessing: fork its fork server, start others as usual; return the pid."""
    if "multiprocessing.forkserver" not in words[-1]:
        return int(_COLD(program, words, kept))
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        lowest = 3
        for descriptor in (*sorted(kept), _MOST_DESCRIPTORS):
            os.closerange(lowest, descriptor)
            lowest = descriptor + 1
        try:
            exec(words[-1], {})  # noqa: S102 - the code that a new interpreter would run
        finally:  # it raises SystemExit when the command has ended
            os._exit(0)
    return child


def _load_libsumo() -> None:
    """Load libsumo's shared library, the slow part of its import; the rest sets variables, which each command does."""
    places = getattr(find_spec("libsumo"), "submodule_search_locations", None) or ()
    for library in (path for place in places for path in Path(place).glob("_libsumo.*")):
        ctypes.CDLL(str(library))


def _serve() -> None:
    with socket.socket(fileno=int(sys.argv[1])) as requests:
        for module in MODULES:
            import_module(module)
        if os.environ.get("PYTHONHASHSEED") == "0":
            import_module(_WITH_OPTIMISER)
        _load_libsumo()
        pages = import_module("advdiff_sumo.report.templates").templates()
        for name in ("page.html", "episode.html"):
            pages.get_template(name)  # compiles it
        gc.freeze()
        _become_next_command(requests)
    try:
        runpy.run_module("advdiff_sumo", run_name="__main__", alter_sys=True)
    except SystemExit as error:
        if not isinstance(error.code, int | None):
            raise
        _end(error.code or 0)


def _end(code: int) -> NoReturn:
    """End the process like the interpreter, but without cleaning up modules."""
    threading._shutdown()  # waits for threads, as the interpreter does
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


if __name__ == "__main__":
    _serve()
