"""Start a planner's server, and make sure that it never outlives this process."""

from __future__ import annotations

import contextlib
import logging
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import weakref
from pathlib import Path

from advdiff_sumo.core.errors import ConfigError, PlannerCrashedError, PlannerTimeoutError
from advdiff_sumo.core.process_end import how_it_ended
from advdiff_sumo.planner_kit.planner_server import ADDRESS_VARIABLE
from advdiff_sumo.planners.remote import keeper

_log = logging.getLogger(__name__)
_POLL_S, _END_S = 0.01, 5.0
_TAIL_BYTES, _LOG_BYTES = 4000, 1 << 20
#: Placeholder in a command for the address, as an alternative to the environment variable.
ADDRESS_FIELD = "{address}"
#: Longest path of a socket in bytes: 107 on Linux, 103 on macOS.
_SOCKET_BYTES = 103


def _socket_folder() -> Path:
    """Return a new temporary folder whose path is short enough for a socket in it."""
    folder = Path(tempfile.mkdtemp(prefix="advdiff-planner-"))
    if len(os.fsencode(folder / "socket")) > _SOCKET_BYTES:
        folder.rmdir()
        folder = Path(tempfile.mkdtemp(prefix="advdiff-planner-", dir="/tmp"))
    return folder


class PlannerProcess:
    """A running server. Its keeper process ends it at :meth:`end`, or when this process ends in any way.

    Attributes:
        address: address at which it is to listen.
    """

    def __init__(self, command: str, who: str) -> None:
        """Start *command*.

        Raises:
            ConfigError: the command cannot be split into words.
        """
        self.who, words = who, split_command(command)
        self._folder = _socket_folder()
        self._socket, self._log = self._folder / "socket", self._folder / "log"
        self.address = f"unix:{self._socket}"
        self._shown_bytes = self._episode_byte = 0
        self._start_output: str | None = None
        words = [word.replace(ADDRESS_FIELD, self.address) for word in words]
        try:
            self._keeper = self._started(words)
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        _log.info("started %s for %s", shlex.join(words), self.address)
        self._finish = weakref.finalize(self, _end, self._keeper, self._folder)

    def _started(self, words: list[str]) -> subprocess.Popen[bytes]:
        """Return the keeper of the command *words*; it also removes the folder if this process dies."""
        with self._log.open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-I", "-S", keeper.__file__, f"{keeper.FOLDER}{self._folder}", *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env={**os.environ, ADDRESS_VARIABLE: self.address},
                start_new_session=True,  # Ctrl-C must reach this process only
            )

    def wait(self, timeout_s: float) -> None:
        """Wait until something listens at the address.

        Raises:
            PlannerCrashedError: the command ended first.
            PlannerTimeoutError: nothing listens after *timeout_s*.
        """
        deadline_s = time.monotonic() + timeout_s
        while not self._socket.exists():
            if self._keeper.poll() is not None:
                raise PlannerCrashedError(f"{self.who}: its command {self.how_ended()}{self._last_line()}")
            if time.monotonic() > deadline_s:
                raise PlannerTimeoutError(f"{self.who}: its command opened no server within {timeout_s:g} s")
            time.sleep(_POLL_S)

    def how_ended(self) -> str:
        """Return how the command ended, as the end of a sentence; "" if it has not ended within some seconds."""
        try:  # with its input left open: closing it would make the keeper end the command
            self._keeper.wait(timeout=_END_S)
        except subprocess.TimeoutExpired:
            return ""
        assert self._keeper.stdout is not None  # noqa: S101 - it is a pipe
        lines = self._keeper.stdout.read().decode().split()
        return how_it_ended(int(lines[-1])) if lines else "was lost"

    def begin_episode(self) -> None:
        """Note that what it writes from now on belongs to a new episode; before the first, to its start."""
        text, self._episode_byte = self._tail(0)
        if self._start_output is None:
            self._start_output = text

    def output(self) -> str:
        """Return the end of what it wrote as it started and in the present episode."""
        text, self._shown_bytes = self._tail(self._episode_byte)
        return f"{self._start_output or ''}\n{text}".strip()[-_TAIL_BYTES:]

    def new_output(self) -> str:
        """Return the end of what it wrote since the last call of this or of :meth:`output`."""
        text, self._shown_bytes = self._tail(self._shown_bytes)
        return text

    def _tail(self, first_byte: int) -> tuple[str, int]:
        """Return the end of its log from *first_byte* on, and the length of the log in bytes."""
        with contextlib.suppress(OSError), self._log.open("rb") as log:
            size = log.seek(0, os.SEEK_END)
            log.seek(max(first_byte, size - _TAIL_BYTES))
            return log.read(_TAIL_BYTES).decode(errors="replace").strip(), size
        return "", first_byte

    def trim_log(self) -> None:
        """Empty its log once it is long."""
        with contextlib.suppress(OSError):
            if self._log.stat().st_size > _LOG_BYTES:
                os.truncate(self._log, 0)
                self._shown_bytes = 0

    def end(self) -> None:
        """End it and all processes that it started."""
        _log.info("ending the server at %s", self.address)
        self._finish()

    def _last_line(self) -> str:
        """Return the last line of its output, as the end of a sentence."""
        lines = self.output().splitlines()
        return f", saying: {lines[-1].strip()[:300]}" if lines else ""


def split_command(command: str) -> list[str]:
    """Return the words of *command*, as a shell would split them.

    Raises:
        ConfigError: a quotation mark is not closed, or there is no word.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ConfigError(f"target 'exec:{command}': {error}; close the quotation marks") from None
    if not words:
        raise ConfigError("target 'exec:' names no command; write it like \"exec:python my_server.py\"")
    return words


def _end(process: subprocess.Popen[bytes], folder: Path) -> None:
    """Close the pipes of the keeper *process*, wait for its end, and remove *folder*."""
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    shutil.rmtree(folder, ignore_errors=True)
