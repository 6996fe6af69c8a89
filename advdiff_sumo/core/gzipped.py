"""Files that may be gzipped, whatever their names say."""

from __future__ import annotations

import gzip
import zlib
from io import BufferedReader
from pathlib import Path

GZIP = b"\x1f\x8b"
DAMAGED_GZIP = (EOFError, zlib.error, gzip.BadGzipFile)
"""What reading from :func:`unpacked` raises where the data are cut off or damaged; the last one is an OSError, too."""
GZIP_PROBLEM, GZIP_REMEDY = "the gzip data are cut off or damaged", "copy or make the file anew"


def unpacked(path: Path) -> gzip.GzipFile | BufferedReader:
    """Open *path* for reading what it holds, unpacked where it is gzipped.

    Raises:
        OSError: the file cannot be opened.
    """
    with path.open("rb") as file:
        zipped = file.read(len(GZIP)) == GZIP
    return gzip.open(path) if zipped else path.open("rb")
