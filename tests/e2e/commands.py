"""Commands as a user types them, in processes of their own, and what they leave on disk."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

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


_IN_TURN = """
import contextlib, io, json, sys
from advdiff_sumo.cli.main import main
for words in json.load(sys.stdin):
    sys.argv, code, out, err = ["advdiff-sumo", *words], 0, io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code
    print(json.dumps([code or 0, out.getvalue(), err.getvalue()]))
"""


def advdiff_in_turn(commands: Iterable[Iterable[object]], cwd: Path) -> list[Outcome]:
    """Run commands one after the other in one process, each to its end, where starting would take longest."""
    words = json.dumps([[*map(str, command)] for command in commands])
    done = subprocess.run(
        [sys.executable, "-c", _IN_TURN],
        input=words,
        cwd=cwd,
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
        timeout=HANG_S,
    )
    return [Outcome(*json.loads(line)) for line in done.stdout.splitlines()]


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
