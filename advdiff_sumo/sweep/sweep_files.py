"""Read and write a sweep's files: complete or absent, with a checksum; a full disk has an error of its own."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import FileError, is_disk_full, os_reason
from advdiff_sumo.core.whole_file import sha256_of, whole_file

_NO_VERSIONS = {"inputs", "repeats"}  # entries beside versions in the table of versions
_HEADER = b"advdiff-sumo 1 "


class DiskFullError(FileError):
    """The disk is full."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "the disk is full", "free some space and go on with --resume")


def write_checked(path: Path, content: bytes) -> None:
    """Write *content* after a line with its checksum. After a power cut, *path* is the complete old or new file.

    Raises:
        DiskFullError: the disk is full.
        FileError: it cannot be written for another reason.
    """
    checksum = hashlib.sha256(content).hexdigest().encode()
    write_whole(path, _HEADER + checksum + b"\n" + content)


def read_checked(path: Path) -> bytes | None:
    """Return the content written by :func:`write_checked`; None if it is missing, truncated or changed."""
    try:
        header, newline, content = path.read_bytes().partition(b"\n")
    except OSError:
        return None
    checksum = hashlib.sha256(content).hexdigest().encode()
    return content if newline and header == _HEADER + checksum else None


def written_checksum(path: Path) -> str:
    """Return the line with the checksum written by :func:`write_checked`; "" if there is no file."""
    try:
        with path.open("rb") as file:
            return file.readline().decode(errors="replace").strip()
    except OSError:
        return ""


def write_whole(path: Path, content: bytes) -> None:
    """Write *content* to a temporary file, then rename it to *path*; errors as in :func:`write_checked`."""
    try:
        with whole_file(path) as aside:
            aside.write_bytes(content)
    except OSError as error:
        raise unwritable(path, error) from None


def unwritable(path: Path, error: OSError) -> FileError:
    """Return the error for a file that cannot be written."""
    if is_disk_full(error):
        return DiskFullError(path)
    return FileError(path, f"cannot be written ({os_reason(error)})", "choose another --out")


def checksum_of(path: Path) -> str:
    """Return the checksum of a file's content; "" if it is missing."""
    try:
        return sha256_of(path)
    except OSError:
        return ""


def with_earlier(settings: Mapping[str, Any], table: str, before: Mapping[str, Any]) -> dict[str, Any]:
    """Return *settings* with the differing versions of the first writer of the file, under ``begun_with``.

    Args:
        settings: content to write.
        table: name of the table with the versions.
        before: present content of the file.
    """
    now, old = settings[table], before.get(table, {})
    changed = (name for name in old if now.get(name, old[name]) != old[name] and name not in _NO_VERSIONS)
    begun_with = old.get("begun_with") or {name: old[name] for name in changed}
    return {**settings, table: {**now, "begun_with": begun_with}} if begun_with else dict(settings)
