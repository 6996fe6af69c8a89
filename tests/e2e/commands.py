"""Commands as a user types them, in processes of their own, and what they leave on disk."""

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
    """How a command ended.

    Attributes:
        code: exit code.
        out: standard output.
        err: standard error.
    """

    code: int
    out: str
    err: str


def environment(hash_seed: int = 0) -> dict[str, str]:
    """Return this process's environment, with another order of Python's sets."""
    return {**os.environ, "PYTHONHASHSEED": str(hash_seed), "COLUMNS": "100", "NO_COLOR": "1"}


def advdiff(
    *words: object, cwd: Path, hash_seed: int = 0, program: tuple[str, ...] = MODULE, narrow: bool = True
) -> Outcome:
    """Run a command to its end, in 100 columns, or with tables as wide as what is in them."""
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


#: What may differ between a command and the process it is forked from: what is read late, what commands set themselves,
#: and what SUMO, pyproj and PyTorch set in this process when a test imports them.
_READ_LATE = frozenset(
    {
        *("COLUMNS", "PYTEST_CURRENT_TEST", "TMPDIR", *VARIABLES),
        *("SUMO_HOME", "PROJ_LIB", "PROJ_DATA", "KMP_DUPLICATE_LIB_OK"),
    }
)


@cache
def _started(hash_seed: int) -> WarmStart:
    """Return the process that commands with this order of Python's sets are forked from, begun once."""
    begun = WarmStart(environment(hash_seed))
    atexit.register(begun.end)
    return begun


def _warm_start(variables: dict[str, str], hash_seed: int) -> WarmStart | None:
    """Return the process that a command is forked from, or None for one in another environment: it starts cold."""
    kept = _started(hash_seed).environment
    changed = {name for name in kept.keys() | variables.keys() if kept.get(name) != variables.get(name)}
    return _started(hash_seed) if changed <= _READ_LATE else None


def begin(*words: object, cwd: Path, hash_seed: int = 0) -> subprocess.Popen[str]:
    """Start a command; Ctrl-C reaches it also where the tests were started in the background, deaf to it."""
    pipe = subprocess.PIPE
    command = [*MODULE, *map(str, words)]
    heard = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:  # a handler of Python's own becomes the default in the new process, "ignored" would stay
        env = environment(hash_seed)
        return subprocess.Popen(command, cwd=cwd, env=env, stdout=pipe, stderr=pipe, text=True)
    finally:
        signal.signal(signal.SIGINT, heard)


def bytes_of(folder: Path) -> dict[str, bytes]:
    """Return the files that the same options and seed must give again."""
    return {name: (folder / name).read_bytes() for name in SAME_BYTES}


def everything(folder: Path) -> dict[str, bytes | None]:
    """Return all that lies in *folder*: files with their content, folders; Python's own caches left out."""
    found = (path for path in sorted(folder.rglob("*")) if "__pycache__" not in path.parts)
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in found}
