"""Run a command until it ends or standard input closes, then end it and every process that it started.

This script runs in an interpreter without any package. The process that holds the other end of the pipe may die
in any way: no process of the command stays behind. Without ``/proc``, only its process group is ended. The last
line on standard output is the command's exit code, negative for a signal. A dead parent cannot clean up, so a
folder named before the command, ``--folder=PATH``, is removed once standard input is closed.
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
_GRACE_S = 0.5  # between asking a process to end and killing it
_POLL_S, _WATCH_S = 0.01, 0.05
PROC = Path("/proc")
_THREADS_FIELD = 20 - 3
"""Index of the number of threads (field 20 of ``/proc/PID/stat``), counted from the state (field 3)."""


def main() -> None:
    """Run the command in ``sys.argv[1:]``, which may begin with the folder."""
    words = sys.argv[1:]
    folder = words.pop(0).removeprefix(FOLDER) if words[0].startswith(FOLDER) else ""
    code = _run(words)
    if folder and _input_closed():
        import shutil  # late: so that the command starts at once

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
    """Wait until *command* ends or the other end of standard input is closed."""
    ended = _pidfd(command.pid)
    if ended is None:
        while command.poll() is None and not _input_closed(_WATCH_S):
            pass
        return
    poll = select.poll()
    poll.register(ended, select.POLLIN)
    poll.register(0, select.POLLIN | select.POLLHUP)
    poll.poll()
    os.close(ended)


def _input_closed(within_s: float = 0.0) -> bool:
    """Return whether the other end of standard input is closed now or within *within_s*."""
    return bool(select.select([0], [], [], within_s)[0])


def _pidfd(pid: int) -> int | None:
    """Return a descriptor that becomes readable when *pid* ends; None if the system has none (macOS, old Linux)."""
    try:
        return os.pidfd_open(pid)
    except (AttributeError, OSError):
        return None


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent ends; only Linux supports it."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_descendants() -> None:
    """Send SIGTERM to all descendants, and SIGKILL to those that still run half a second later."""
    start_s = time.monotonic()
    signal_sent = signal.SIGTERM
    signalled: set[int] = set()
    while children := _children() or _children():  # an orphan may be adopted during the first listing
        if signal_sent is signal.SIGTERM and time.monotonic() - start_s > _GRACE_S:
            signal_sent, signalled = signal.SIGKILL, set()
        for pid in children:
            if pid not in signalled:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal_sent)
                signalled.add(pid)
        time.sleep(_POLL_S)


def end_group(command: subprocess.Popen[bytes]) -> None:
    """Send SIGTERM to the process group of *command*, and SIGKILL if it still exists half a second later."""
    deadline_s = time.monotonic() + _GRACE_S
    with contextlib.suppress(ProcessLookupError, PermissionError):  # the group is empty
        os.killpg(command.pid, signal.SIGTERM)
        while time.monotonic() < deadline_s:
            command.poll()  # else it stays as a zombie
            os.killpg(command.pid, 0)
            time.sleep(_POLL_S)
        os.killpg(command.pid, signal.SIGKILL)


def _children() -> list[int]:
    """Return the children that have not ended; orphans of a child become children themselves."""
    own = str(os.getpid())
    return [int(folder.name) for folder in PROC.glob("[0-9]*") if _parent(folder) == own]


def _parent(folder: Path) -> str:
    """Return the parent's id of a process; "" if the process has ended.

    A process whose first thread has ended (state Z) still exists, and keeps its children, until its last thread ends.
    """
    try:
        stat = (folder / "stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    fields = stat.rpartition(")")[2].split()  # from field 3 on, the state
    state, parent, threads = fields[0], fields[1], int(fields[_THREADS_FIELD])
    return "" if state == "Z" and threads <= 1 else parent


if __name__ == "__main__":
    main()
