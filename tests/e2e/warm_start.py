"""A process that has imported what commands import, and forks one for each command; this script is that process.

A command started so ends as one started cold: it has its own working folder, environment, standard streams and exit
code, waits for its threads and runs what was registered for its end. Only the seconds of importing, and of taking apart
all that was imported, are saved, hundreds of times.
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

#: What commands and workers import, that included which single verbs need and which takes long.
MODULES = (
    *("advdiff_sumo.cli.main", "advdiff_sumo.sim.run_episodes", "advdiff_sumo.sweep.executors"),
    *("advdiff_sumo.sweep.work", "advdiff_sumo.report.page", "scipy.signal", "torch"),
    *("pyarrow.dataset", "typer.rich_utils"),
    *("advdiff_sumo.experiments.bench.runner", "advdiff_sumo.sim.measured_conversion"),
    *("advdiff_sumo.experiments.judge_folder", "advdiff_sumo.experiments.warmup_run", "advdiff_sumo.export"),
    *("advdiff_sumo.training.setup", "advdiff_sumo.traffic.diffusion.diffusion_policy"),
)
#: What PyTorch imports with its first optimiser; commands in another order of sets than 0 hardly have one.
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
    """Starts commands from one process, in the environment that it began with."""

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
        """Write ``advdiff-sumo`` into *folder*: run by a shell that was given ``descriptor``, one at a time."""
        program = folder / "advdiff-sumo"
        program.write_text(
            _CLIENT.format(python=sys.executable, descriptor=self.descriptor), encoding="utf-8"
        )
        program.chmod(0o755)

    @property
    def descriptor(self) -> int:
        """Through which requests go."""
        return self._socket.fileno()

    def end(self) -> None:
        """Let the process end, and whatever hangs in it."""
        self._socket.close()
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def _text(descriptor: int) -> str:
    with os.fdopen(os.dup(descriptor), encoding="utf-8") as stream:
        stream.seek(0)
        return stream.read()


def _become_next_command(requests: socket.socket) -> None:
    """Serve requests; return in each process that is to run a command, and never in the one that serves."""
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
    """Give this process the words, the folder, the environment and the streams of a command."""
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
    """Start what multiprocessing asks for as it does, but fork its fork server; return the process's number."""
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
            exec(words[-1], {})  # noqa: S102 - the line that a new interpreter would be given
        finally:  # it leaves by SystemExit when the command is gone
            os._exit(0)
    return child


def _load_libsumo() -> None:
    """Load libsumo's machine code, nearly all of its import; the rest sets variables, which is up to each command."""
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
    except SystemExit as left:
        if not isinstance(left.code, int | None):
            raise
        _end(left.code or 0)


def _end(code: int) -> NoReturn:
    """End as the interpreter does, but leave taking modules apart to the system."""
    threading._shutdown()  # waits for threads; the interpreter calls it, too
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


if __name__ == "__main__":
    _serve()
