"""Reads JSON tables record by record, so that a table of gigabytes needs memory for one chunk only."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO, TypeVar

from advdiff_sumo.core.errors import LogError, os_reason

_CHUNK = 1 << 22  # characters read at a time
_LONGEST = 1 << 22  # characters of the longest possible record; longer unparsable text is malformed
_WORD = 32  # characters of the longest number or literal
_AGAIN = "copy or download the file again"
_SEPARATORS = " \t\r\n,"

T = TypeVar("T")


def parsed(path: Path, parse: Callable[[dict[str, Any]], T]) -> Iterator[T]:
    """Yield ``parse(record)`` for each record of the table at *path*.

    Raises:
        LogError: the file is missing, truncated or malformed, or *parse* raised KeyError, TypeError, ValueError or
            IndexError for a record. The message names the record.
    """
    for number, record in enumerate(records(path)):
        try:
            yield parse(record)
        except KeyError as error:
            raise LogError(path, f"{_name(number, record)} has no {error}", _AGAIN) from None
        except (TypeError, ValueError, IndexError) as error:
            raise LogError(path, f"{_name(number, record)} cannot be used ({error})", _AGAIN) from None


def records(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the objects of the JSON array at *path*.

    Raises:
        LogError: the file is missing, truncated or not an array of objects.
    """
    try:
        with path.open(encoding="utf-8") as file:
            yield from _objects(path, file)
    except FileNotFoundError:
        raise LogError(path, "no such table", "give the dataset root that holds it") from None
    except UnicodeDecodeError:
        raise LogError(path, "is not UTF-8 text", _AGAIN) from None
    except OSError as error:
        raise LogError(path, f"cannot be read ({os_reason(error)})") from None


def _objects(path: Path, file: TextIO) -> Iterator[dict[str, Any]]:
    decode = json.JSONDecoder().raw_decode
    buffer = file.read(_CHUNK).lstrip()
    if not buffer.startswith("["):
        raise LogError(path, "is not a JSON array of records", "give a nuScenes table")
    position, number = 1, 0
    while True:
        position = _skip_separators(buffer, position)
        if buffer[position : position + 1] == "]":
            return
        try:
            record, position = decode(buffer, position)
        except json.JSONDecodeError as error:  # read on: the record may continue after the buffer
            more = file.read(_CHUNK)
            if not more and _is_cut_off(error):
                raise LogError(path, f"ends within record {number}: the file is truncated", _AGAIN) from None
            if not more or len(buffer) - position > _LONGEST:
                raise LogError(path, f"record {number} is not JSON ({error.msg})", _AGAIN) from None
            buffer, position = buffer[position:] + more, 0
            continue
        if not isinstance(record, dict):
            raise LogError(path, f"record {number} is no object", _AGAIN)
        yield record
        number += 1


def _is_cut_off(error: json.JSONDecodeError) -> bool:
    """Return whether the text ends too early: within a string, or within a literal or number."""
    rest = error.doc[error.pos :].strip()
    return error.msg.startswith("Unterminated") or (len(rest) < _WORD and not rest.endswith(("]", "}")))


def _skip_separators(buffer: str, position: int) -> int:
    while position < len(buffer) and buffer[position] in _SEPARATORS:
        position += 1
    return position


def _name(number: int, record: dict[str, Any]) -> str:
    token = record.get("token")
    return f"record {number} (token {token})" if token else f"record {number}"
