"""Read the XML elements of demand files and SUMO configurations, gzipped or not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from defusedxml.ElementTree import iterparse

from advdiff_sumo.core.errors import FileError, os_reason
from advdiff_sumo.core.gzipped import DAMAGED_GZIP, GZIP_PROBLEM, GZIP_REMEDY, is_gzipped, unpacked
from advdiff_sumo.core.xml_errors import UNREADABLE_XML

_CHUNK_BYTES = 1 << 20


def content_of(path: Path) -> bytes:
    """Return the content of a demand file, unzipped if necessary.

    Raises:
        FileError: it cannot be read, or its gzip data are damaged.
    """
    return b"".join(_chunks(path))


def check_whole(path: Path) -> None:
    """Read *path* to its end if it is gzipped; the check of its first routes does not read all of it.

    Raises:
        FileError: it cannot be read, or its gzip data are damaged.
    """
    if is_gzipped(path):
        for _ in _chunks(path):
            pass


def _chunks(path: Path) -> Iterator[bytes]:
    try:
        with unpacked(path) as file:
            while chunk := file.read(_CHUNK_BYTES):
                yield chunk
    except DAMAGED_GZIP:
        raise FileError(path, GZIP_PROBLEM, GZIP_REMEDY) from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({os_reason(error)})") from None


def elements(path: Path) -> Iterator[Element]:
    """Yield the elements of *path* in the order of their end tags, inner elements first.

    Raises:
        FileError: it cannot be read, is truncated, or is not XML.
    """
    try:
        with unpacked(path) as file:
            yield from (element for _, element in iterparse(file, events=("end",)))
    except DAMAGED_GZIP:
        raise FileError(path, GZIP_PROBLEM, GZIP_REMEDY) from None
    except UNREADABLE_XML as error:
        raise FileError(
            path, f"not well-formed XML ({error})", "it may be truncated: export it again"
        ) from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({os_reason(error)})") from None


def seconds(text: str) -> float | None:
    """Return a time of SUMO, in seconds or [days:]hours:minutes:seconds; None for words such as "triggered"."""
    parts = text.split(":")
    factors = (1.0, 60.0, 3600.0, 86_400.0)
    try:
        return sum(factor * float(part) for factor, part in zip(factors, reversed(parts), strict=False))
    except ValueError:
        return None
