"""Where an episode stands, in memory that outlives the process in which it runs."""

from __future__ import annotations

import mmap
import os
import struct
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

_LAYOUT = struct.Struct("<qqqd")
_SIZE = _LAYOUT.size + 4  # with its checksum
NOT_STARTED = -1
"""Steps of an episode whose start is not over."""


class ProcessPhase(IntEnum):
    """What the process is doing."""

    OTHER = 0
    SIMULATOR = 1
    TARGET = 2
    BACKGROUND = 3
    MAKING_TARGET = 4
    MAKING_BACKGROUND = 5


@dataclass(frozen=True)
class Beat:
    """What was written last.

    Attributes:
        pid: process number of the worker.
        phase: what it is doing.
        steps: SUMO steps that are recorded; ``NOT_STARTED`` before the first.
        since_s: when the phase began, on the monotonic clock of the machine.
    """

    pid: int
    phase: ProcessPhase
    steps: int
    since_s: float


class Heartbeat:
    """Notes each phase and step of an episode; a microsecond a note.

    Attributes:
        phase: the present one.
        steps: as in :class:`Beat`.
    """

    def __init__(self, path: Path | None = None) -> None:
        """Write to *path*, which another process may read at any time; None: for this process alone."""
        self.phase, self.steps = ProcessPhase.OTHER, NOT_STARTED
        self._pid = os.getpid()
        self._memory: mmap.mmap | bytearray = bytearray(_SIZE)
        if path is not None:
            with path.open("w+b") as file:
                file.truncate(_SIZE)
                self._memory = mmap.mmap(file.fileno(), _SIZE)
        self.note(ProcessPhase.OTHER)

    def note(self, phase: ProcessPhase, steps: int | None = None) -> None:
        """Write down that *phase* begins now, after *steps* steps where they have changed."""
        self.phase = phase
        self.steps = self.steps if steps is None else steps
        self._memory[:] = _sealed(_LAYOUT.pack(self._pid, phase, self.steps, time.monotonic()))

    @contextmanager
    def during(self, phase: ProcessPhase) -> Iterator[None]:
        """Be in *phase* for a block."""
        before = self.phase
        self.note(phase)
        try:
            yield
        finally:
            self.note(before)

    @staticmethod
    def read(path: Path) -> Beat | None:
        """Return what the process that writes to *path* noted last.

        None where it has written nothing, or is halfway through a note just now: memory that two processes share can
        be read between two of its bytes, and a beat of old and new ones would look long overdue.
        """
        try:
            content = path.read_bytes()
        except OSError:
            return None
        beat = content[: _LAYOUT.size]
        if content != _sealed(beat):
            return None
        pid, phase, steps, since_s = _LAYOUT.unpack(beat)
        return Beat(pid, ProcessPhase(phase), steps, since_s)


def _sealed(beat: bytes) -> bytes:
    """Return the packed *beat* and the checksum by which a reader tells that it is whole."""
    return beat + zlib.crc32(beat).to_bytes(4, "little")
