"""Reads and writes ``margin.csv``: all trials of the margins of a seed scene, and their episodes in the folder.

A second file holds the command that repeats them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from advdiff_sumo.core.errors import FileError

TRIALS = "margin.csv"
#: File with the options of a margin; written before the first trial.
SUBJECT = "margin.json"
COMMAND = "margin.txt"
"""File with the command that repeats the margins."""
_REMEDY = "repeat advdiff-sumo margin with the same --out"


@dataclass(frozen=True)
class TrialRow:
    """One line of the file.

    Attributes:
        attack: its kind.
        by: name of the scale of severity.
        value: of the severity.
        unit: of the value.
        encounter: without failure: whether the encounter took place; with one: whether the attacker was involved.
        valid_failure: whether it ended in a valid failure.
        episode: its number in the folder's tables; None if it is not one of the two neighbouring trials.
    """

    attack: str
    by: str
    value: float
    unit: str
    encounter: bool
    valid_failure: bool
    episode: int | None


def trials_text(rows: Iterable[TrialRow]) -> str:
    """Return the content of the file."""
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow([field.name for field in fields(TrialRow)])
    writer.writerows([_text(value) for value in astuple(row)] for row in rows)
    return sink.getvalue()


def _text(value: str | float | None) -> str:
    if value is None:
        return ""
    return (
        str(value).lower() if isinstance(value, bool) else value if isinstance(value, str) else f"{value:g}"
    )


def read_trials(folder: Path) -> tuple[TrialRow, ...]:
    """Return the trials in *folder*; none if it has no such file.

    Raises:
        FileError: the file is damaged.
    """
    path = folder / TRIALS
    try:
        lines = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))
        return tuple(_row(line) for line in lines)
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, KeyError) as error:
        raise FileError(path, f"is damaged ({error})", _REMEDY) from None


def read_command(folder: Path) -> str:
    """Return the command that repeats the margins in *folder*; "" if it is unknown.

    Raises:
        FileError: the file is damaged.
    """
    path = folder / COMMAND
    try:
        return path.read_text(encoding="utf-8").strip()
    except FileNotFoundError:
        return ""
    except (OSError, ValueError) as error:
        raise FileError(path, f"is damaged ({error})", _REMEDY) from None


def _row(line: dict[str, str]) -> TrialRow:
    return TrialRow(
        line["attack"],
        line["by"],
        float(line["value"]),
        line["unit"],
        line["encounter"] == "true",
        line["valid_failure"] == "true",
        int(line["episode"]) if line["episode"] else None,
    )
