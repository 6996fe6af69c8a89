"""A sweep's files: whole or not there, with a checksum, and a full disk told from other failures."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.whole_file import whole_file

_NO_VERSIONS = {"inputs", "repeats"}
_MAGIC = b"advdiff-sumo 1 "
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


def written_checksum(path: Path) -> str:
    """Return the checksum that :func:`write_checked` wrote in front; "" where there is none."""
    try:
        with path.open("rb") as file:
            return file.readline().decode(errors="replace").strip()
    except OSError:
        return ""


def write_whole(path: Path, content: bytes) -> None:
    """Write *content* to *path*, aside first; errors as in :func:`write_checked`."""
    try:
        with whole_file(path) as aside:
            aside.write_bytes(content)
    except OSError as error:
        raise unwritable(path, error) from None


def unwritable(path: Path, error: OSError) -> FileError:
    """Return the sentence for a file that cannot be written."""
    if error.errno in _FULL:
        return DiskFullError(path)
    return FileError(path, f"cannot be written ({os_reason(error)})", "choose another --out")


def checksum_of(path: Path) -> str:
    """Return the checksum of a whole file; "" when it is missing."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def changed_code(now: Mapping[str, Any], before: Mapping[str, Any]) -> list[str]:
    """Return the planners and policies of whose files the versions *now* and *before* tell different digests."""
    begun = {**before, **before.get("begun_with", {})}
    return [name for name in now if ":" in name and begun.get(name, now[name]) != now[name]]


def with_earlier(settings: Mapping[str, Any], table: str, before: Mapping[str, Any]) -> dict[str, Any]:
    """Return *settings* with the versions that *before*, the same file so far, was begun with where these differ.

    Args:
        settings: what is written.
        table: in which the versions are.
        before: what stands there.
    """
    now, old = settings[table], before.get(table, {})
    others = (name for name in old if now.get(name, old[name]) != old[name] and name not in _NO_VERSIONS)
    kept = old.get("begun_with") or {name: old[name] for name in others}
    return {**settings, table: {**now, "begun_with": kept}} if kept else dict(settings)
