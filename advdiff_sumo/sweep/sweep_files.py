"""Files that are whole or not there: written aside, flushed, renamed, and checked when they are read."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
from pathlib import Path

from advdiff_sumo.core.errors import FileError

_MAGIC = b"advdiff-sumo 1 "
#: Ends the name of a file that is being written.
ASIDE = ".aside"
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


class DiskFullError(FileError):
    """There is no room left for results."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "the disk is full", "free some space and go on with --resume")


def write_checked(path: Path, content: bytes) -> None:
    """Write *content* behind a line with its checksum; after a power cut *path* is the old or the new file.

    Raises:
        DiskFullError: there is no room.
        FileError: it cannot be written for another reason.
    """
    checksum = hashlib.sha256(content).hexdigest().encode()
    write_whole(path, _MAGIC + checksum + b"\n" + content)


def read_checked(path: Path) -> bytes | None:
    """Return what :func:`write_checked` wrote; None when it is missing, cut off or changed."""
    try:
        head, newline, content = path.read_bytes().partition(b"\n")
    except OSError:
        return None
    checksum = hashlib.sha256(content).hexdigest().encode()
    return content if newline and head == _MAGIC + checksum else None


def write_whole(path: Path, content: bytes) -> None:
    """Write *content* to *path*, aside first; errors as in :func:`write_checked`."""
    aside = aside_of(path)
    try:
        with aside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        settle(aside, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise unwritable(path, error) from None


def aside_of(path: Path) -> Path:
    """Return where this process writes *path* before it gets its name."""
    return path.with_name(f"{path.name}.{os.getpid()}{ASIDE}")


def settle(aside: Path, path: Path) -> None:
    """Give a flushed file its name, and let the folder remember it."""
    aside.replace(path)
    if os.name == "posix":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def unwritable(path: Path, error: OSError) -> FileError:
    """Return the sentence for a file that cannot be written."""
    if error.errno in _FULL:
        return DiskFullError(path)
    return FileError(path, f"cannot be written ({error.strerror or error})", "choose another --out")


def checksum_of(path: Path) -> str:
    """Return the checksum of a whole file; "" when it is missing."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""
