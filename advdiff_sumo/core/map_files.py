"""Read a map or scenario file, in JSON or XML, gzipped or not, of bounded size."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from defusedxml import ElementTree

from advdiff_sumo.core.errors import MapError, os_reason
from advdiff_sumo.core.gzipped import DAMAGED_GZIP, GZIP_PROBLEM, GZIP_REMEDY, unpacked
from advdiff_sumo.core.xml_errors import UNREADABLE_XML

MAX_FILE_BYTES = 600_000_000  # the largest genuine file has about a tenth of that


def load_json(path: Path, remedy: str) -> Any:
    """Return the content of the JSON file *path*; the error's *remedy* says what to provide instead.

    Raises:
        MapError: the file cannot be read, is too large, or is no JSON text.
    """
    try:
        return json.loads(_bytes(path).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise MapError(path, f"is no JSON text ({error})", remedy) from None


def load_xml(path: Path) -> Element:
    """Return the root of the XML document in *path*; entities and external references are refused.

    Raises:
        MapError: the file cannot be read, is too large, or is no XML text.
    """
    try:
        root: Element = ElementTree.fromstring(_bytes(path), forbid_dtd=True)
    except UNREADABLE_XML as error:
        problem = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise MapError(path, f"is no XML text ({problem})", "give an unchanged file") from None
    return root


def _bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise MapError(
                path, f"{size / 1e6:.0f} MB is more than any map expansion has", "give one map's file"
            )
        with unpacked(path) as file:
            content = file.read(MAX_FILE_BYTES + 1)
    except DAMAGED_GZIP:
        raise MapError(path, GZIP_PROBLEM, GZIP_REMEDY) from None
    except OSError as error:
        reason = os_reason(error)
        raise MapError(path, f"cannot be read ({reason})", "give the path of an existing map file") from None
    if len(content) > MAX_FILE_BYTES:
        raise MapError(path, "unpacks to more than any map expansion has", "give one map's file")
    return content
