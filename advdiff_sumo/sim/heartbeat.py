"""Write the progress of an episode into memory that outlives the process in which it runs."""

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
"""Number of steps of an episode that is still starting."""


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
    """The last note of a process.

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
    """Notes each phase and step of an episode; a note takes a microsecond.

    Attributes:
        phase: the present one.
        steps: as in :class:`Beat`.
    """

    def __init__(self, path: Path | None = None) -> None:
        """Write to *path*, which another process may read at any time; None: only keep the notes in this object."""
        self.phase, self.steps = ProcessPhase.OTHER, NOT_STARTED
        self._pid = os.getpid()
        self._memory: mmap.mmap | bytearray = bytearray(_SIZE)
        if path is not None:
            with path.open("w+b") as file:
                file.truncate(_SIZE)
                self._memory = mmap.mmap(file.fileno(), _SIZE)
        self.note(ProcessPhase.OTHER)

    def note(self, phase: ProcessPhase, steps: int | None = None) -> None:
        """Note that *phase* begins now, and the number of recorded *steps* if it has changed."""
        self.phase = phase
        self.steps = self.steps if steps is None else steps
        self._memory[:] = _sealed(_LAYOUT.pack(self._pid, phase, self.steps, time.monotonic()))

    @contextmanager
    def during(self, phase: ProcessPhase) -> Iterator[None]:
        """Note *phase* while the block runs, and the phase before after it."""
        before = self.phase
        self.note(phase)
        try:
            yield
        finally:
            self.note(before)

    @staticmethod
    def read(path: Path) -> Beat | None:
        """Return the last note of the process that writes to *path*.

        Return None if it has written none, or is writing one at the moment. Shared memory can be read between two bytes
        of a note, and a mixture of an old and a new note would look long overdue.
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
    """Return the packed *beat* with a checksum by which a reader recognises a complete note."""
    return beat + zlib.crc32(beat).to_bytes(4, "little")
