"""JSON tables read record by record, so that a table of gigabytes needs memory for one chunk only."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO, TypeVar

from advdiff_sumo.core.errors import LogError, os_reason

_CHUNK = 1 << 22  # characters
_LONGEST = 1 << 22  # no record is as long: what does not parse by then never will
_WORD = 32  # characters of the longest number or literal
_AGAIN = "copy or download the file again"
_GAP = " \t\r\n,"

T = TypeVar("T")


def parsed(path: Path, parse: Callable[[dict[str, Any]], T]) -> Iterator[T]:
    """Yield ``parse(record)`` for each record of the table at *path*.

    Raises:
        LogError: the file is missing, truncated or malformed, or *parse* raised KeyError, TypeError,
            ValueError or IndexError on a record; names the record.
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
    at, number = 1, 0
    while True:
        at = _skip(buffer, at)
        if buffer[at : at + 1] == "]":
            return
        try:
            record, at = decode(buffer, at)
        except json.JSONDecodeError as error:
            more = file.read(_CHUNK)
            if not more and _cut_off(error):
                raise LogError(path, f"ends within record {number}: the file is truncated", _AGAIN) from None
            if not more or len(buffer) - at > _LONGEST:
                raise LogError(path, f"record {number} is not JSON ({error.msg})", _AGAIN) from None
            buffer, at = buffer[at:] + more, 0
            continue
        if not isinstance(record, dict):
            raise LogError(path, f"record {number} is no object", _AGAIN)
        yield record
        number += 1


def _cut_off(error: json.JSONDecodeError) -> bool:
    """Return whether the text ended too early: within a string, or within a last word or number."""
    rest = error.doc[error.pos :].strip()
    return error.msg.startswith("Unterminated") or (len(rest) < _WORD and not rest.endswith(("]", "}")))


def _skip(buffer: str, at: int) -> int:
    while at < len(buffer) and buffer[at] in _GAP:
        at += 1
    return at


def _name(number: int, record: dict[str, Any]) -> str:
    token = record.get("token")
    return f"record {number} (token {token})" if token else f"record {number}"
