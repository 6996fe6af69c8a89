"""Elements of demand files and SUMO configurations, gzipped or not."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import iterparse

from advdiff_sumo.core.errors import FileError

_GZIP = b"\x1f\x8b"


def opened(path: Path) -> gzip.GzipFile | BufferedReader:
    """Open a demand file for reading, gzipped or not, whatever its name says."""
    with path.open("rb") as file:
        zipped = file.read(2) == _GZIP
    return gzip.open(path) if zipped else path.open("rb")


def elements(path: Path) -> Iterator[Element]:
    """Yield the elements of *path* as they end, inner ones first.

    Raises:
        FileError: it cannot be read, is truncated, or no XML.
    """
    try:
        with opened(path) as file:
            yield from (element for _, element in iterparse(file, events=("end",)))
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise FileError(path, "is a truncated gzip file", "export it again") from None
    except (ParseError, DefusedXmlException, LookupError) as error:  # LookupError: unknown encoding
        raise FileError(
            path, f"not well-formed XML ({error})", "it may be truncated: export it again"
        ) from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror})") from None


def seconds(text: str) -> float | None:
    """Return a time of SUMO, in seconds or [days:]hours:minutes:seconds; None where it tells none, as "triggered"."""
    parts = text.split(":")
    factors = (1.0, 60.0, 3600.0, 86_400.0)
    try:
        return sum(factor * float(part) for factor, part in zip(factors, reversed(parts), strict=False))
    except ValueError:
        return None
