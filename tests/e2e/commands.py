"""Run commands as a user types them, in separate processes, and read the files that they write."""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from advdiff_sumo.core.threads import VARIABLES
from tests.e2e.warm_start import WarmStart
from tests.hang_guard import HANG_S

MODULE = (sys.executable, "-m", "advdiff_sumo")
SAME_BYTES = ("episodes.parquet", "states.parquet", "collisions.parquet")
TINY = (
    *("--horizon", "4", "--set", "scene.warmup_s=10"),
    *("--set", "scene.scenes_per_warmup=2", "--set", "scene.min_neighbours=1"),
)


@dataclass(frozen=True)
class Outcome:
    """Result of a command.

    Attributes:
        code: exit code.
        out: standard output.
        err: standard error.
    """

    code: int
    out: str
    err: str


def environment(hash_seed: int = 0) -> dict[str, str]:
    """Return the environment of this process with *hash_seed*, which determines the order of Python's sets."""
    return {**os.environ, "PYTHONHASHSEED": str(hash_seed), "COLUMNS": "100", "NO_COLOR": "1"}


def advdiff(
    *words: object, cwd: Path, hash_seed: int = 0, program: tuple[str, ...] = MODULE, narrow: bool = True
) -> Outcome:
    """Run a command to its end.

    Args:
        words: its arguments.
        cwd: working folder.
        hash_seed: determines the order of Python's sets.
        program: the program; that of the package is forked from a process that has imported everything.
        narrow: whether output has 100 columns; else tables are as wide as their contents.
    """
    variables = environment(hash_seed)
    if not narrow:
        del variables["COLUMNS"]
    started = _warm_start(variables, hash_seed) if program == MODULE else None
    if started is not None:
        return Outcome(*started.run([*map(str, words)], cwd, variables, HANG_S))
    done = subprocess.run(
        [*program, *map(str, words)],
        cwd=cwd,
        env=variables,
        capture_output=True,
        text=True,
        check=False,
        timeout=HANG_S,
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


#: Variables that may differ between a command and the process from which it is forked: they are read after imports,
#: or are set by commands or by SUMO, pyproj and PyTorch when a test imports them.
_READ_LATE = frozenset(
    {
        *("COLUMNS", "PYTEST_CURRENT_TEST", "TMPDIR", *VARIABLES),
        *("SUMO_HOME", "PROJ_LIB", "PROJ_DATA", "KMP_DUPLICATE_LIB_OK"),
    }
)


@cache
def _started(hash_seed: int) -> WarmStart:
    """Return the process from which commands with *hash_seed* are forked; it is started once."""
    process = WarmStart(environment(hash_seed))
    atexit.register(process.end)
    return process


def _warm_start(variables: dict[str, str], hash_seed: int) -> WarmStart | None:
    """Return the process from which a command is forked; None if the environment differs and it must start normally."""
    base = _started(hash_seed).environment
    changed = {name for name in base.keys() | variables.keys() if base.get(name) != variables.get(name)}
    return _started(hash_seed) if changed <= _READ_LATE else None


def begin(*words: object, cwd: Path, hash_seed: int = 0) -> subprocess.Popen[str]:
    """Start a command; it receives Ctrl-C even if the tests run in the background and ignore it."""
    pipe = subprocess.PIPE
    command = [*MODULE, *map(str, words)]
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:  # the new process gets the default handler in place of Python's, but would inherit "ignored"
        env = environment(hash_seed)
        return subprocess.Popen(command, cwd=cwd, env=env, stdout=pipe, stderr=pipe, text=True)
    finally:
        signal.signal(signal.SIGINT, previous)


def bytes_of(folder: Path) -> dict[str, bytes]:
    """Return the contents of the files that are the same for the same options and seed."""
    return {name: (folder / name).read_bytes() for name in SAME_BYTES}


def everything(folder: Path) -> dict[str, bytes | None]:
    """Return path → content of all files and folders (None) in *folder*, except Python's caches."""
    paths = (path for path in sorted(folder.rglob("*")) if "__pycache__" not in path.parts)
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in paths}
