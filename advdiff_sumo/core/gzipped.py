"""Open files that may be gzipped, whatever their names are."""

from __future__ import annotations

import gzip
import zlib
from io import BufferedReader
from pathlib import Path

GZIP = b"\x1f\x8b"
DAMAGED_GZIP = (EOFError, zlib.error, gzip.BadGzipFile)
"""Exceptions from reading :func:`unpacked` if the data are truncated or damaged; the last one is also an OSError."""
GZIP_PROBLEM, GZIP_REMEDY = "the gzip data are cut off or damaged", "copy or make the file anew"


def is_gzipped(path: Path) -> bool:
    """Return whether *path* is gzipped; OSError if it cannot be opened."""
    with path.open("rb") as file:
        return file.read(len(GZIP)) == GZIP


def unpacked(path: Path) -> gzip.GzipFile | BufferedReader:
    """Open *path* for reading its content, unpacked if it is gzipped.

    Raises:
        OSError: the file cannot be opened.
    """
    return gzip.open(path) if is_gzipped(path) else path.open("rb")
