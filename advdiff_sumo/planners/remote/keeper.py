"""Runs a command for as long as its own standard input is open, then ends it and every process that it started.

Started as a script, in an interpreter without any package: the process that holds the other end of the pipe may die in
any way, and nothing of the command stays behind; without ``/proc`` nothing of its process group. The last line on
standard output is the command's exit code, negative for a signal. Whoever dies cannot clean up: a folder that is named
before the command, ``--folder=PATH``, goes once the input is closed.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

FOLDER = "--folder="
_PR_SET_CHILD_SUBREAPER = 36
_GRACE_S, _POLL_S, _WATCH_S = 0.5, 0.01, 0.05
PROC = Path("/proc")
_THREADS = 20 - 3
"""Where ``/proc/PID/stat`` has the number of threads, its field 20, counted from the state."""


def main() -> None:
    """Run ``sys.argv[1:]``, the folder left out."""
    words = sys.argv[1:]
    folder = words.pop(0).removeprefix(FOLDER) if words[0].startswith(FOLDER) else ""
    code = _run(words)
    if folder and _nobody_listens():
        import shutil  # late: the command need not wait for it

        shutil.rmtree(folder, ignore_errors=True)
    sys.stdout.write(f"{code}\n")


def _run(words: list[str]) -> int:
    """Run the command *words* and return its exit code."""
    adopt_orphans()
    lists_processes = (PROC / "self" / "stat").exists()
    try:
        with subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=sys.stderr,
            start_new_session=not lists_processes,
        ) as command:
            _wait(command)
            if lists_processes:
                end_descendants()
            else:
                end_group(command)
            return command.wait()
    except OSError as error:
        sys.stderr.write(f"{words[0]}: {error.strerror or error}\n")
        return 127


def _wait(command: subprocess.Popen[bytes]) -> None:
    """Return when *command* ends, or when nobody holds the other end of standard input any more."""
    ended = _pidfd(command.pid)
    if ended is None:
        while command.poll() is None and not _nobody_listens(_WATCH_S):
            pass
        return
    poll = select.poll()
    poll.register(ended, select.POLLIN)
    poll.register(0, select.POLLIN | select.POLLHUP)
    poll.poll()
    os.close(ended)


def _nobody_listens(within_s: float = 0.0) -> bool:
    """Return whether the other end of standard input is closed, or gets closed *within_s*."""
    return bool(select.select([0], [], [], within_s)[0])


def _pidfd(pid: int) -> int | None:
    """Return a descriptor that becomes readable when *pid* ends; None where the system has none (macOS, old Linux)."""
    try:
        return os.pidfd_open(pid)
    except (AttributeError, OSError):
        return None


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent ends; Linux alone can do that."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_descendants() -> None:
    """Ask all processes below this one to end, and kill what is still there half a second later."""
    asked_at = time.monotonic()
    word = signal.SIGTERM
    asked: set[int] = set()
    while children := _children() or _children():  # one can become ours behind the first look
        if word is signal.SIGTERM and time.monotonic() - asked_at > _GRACE_S:
            word, asked = signal.SIGKILL, set()
        for pid in children:
            if pid not in asked:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, word)
                asked.add(pid)
        time.sleep(_POLL_S)


def end_group(command: subprocess.Popen[bytes]) -> None:
    """Ask the process group that *command* leads to end, and kill what is still there half a second later."""
    until = time.monotonic() + _GRACE_S
    with contextlib.suppress(ProcessLookupError, PermissionError):  # nobody is left
        os.killpg(command.pid, signal.SIGTERM)
        while time.monotonic() < until:
            command.poll()  # else it is there as a zombie
            os.killpg(command.pid, 0)
            time.sleep(_POLL_S)
        os.killpg(command.pid, signal.SIGKILL)


def _children() -> list[int]:
    """Return the children that have not ended; what a child leaves behind becomes one itself."""
    own = str(os.getpid())
    return [int(folder.name) for folder in PROC.glob("[0-9]*") if _parent(folder) == own]


def _parent(folder: Path) -> str:
    """Return the parent of a process; "" for one that has ended.

    One whose first thread has ended (state Z) is there, and keeps its children, until its last one has.
    """
    try:
        stat = (folder / "stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    fields = stat.rpartition(")")[2].split()  # from the third one on, the state
    state, parent, threads = fields[0], fields[1], int(fields[_THREADS])
    return "" if state == "Z" and threads <= 1 else parent


if __name__ == "__main__":
    main()
