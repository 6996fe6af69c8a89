"""Stores a finished table in its folder, and reads it again without running anything."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.experiments.bench.bench_config import Folder
from advdiff_sumo.experiments.bench.bench_figure import draw
from advdiff_sumo.experiments.bench.table import Head, Line, Table
from advdiff_sumo.experiments.bench.write_table import json_text, write_files
from advdiff_sumo.sweep.sweep_files import write_whole

_TABLE, _TIMING, _DONE = "table.json", "timing.json", "done.json"


def save(folder: Folder, table: Table) -> None:
    """Write *table* in every format, with the digest of its request.

    Raises:
        FileError: a file cannot be written.
    """
    write_files(folder.path, table)
    timed = tuple(head for head in table.heads if head.measured)
    write_whole(folder.path / _TIMING, json_text(replace(table, gaps=(), notes=()), timed).encode())
    draw(folder.path / "table.png", table)
    write_whole(folder.path / _DONE, json.dumps({"asked": folder.request_digest}).encode())


def finished_table(folder: Folder) -> Table | None:
    """Return the table of the folder; None if it is missing or belongs to another request.

    Raises:
        FileError: it is damaged.
    """
    try:
        finished_digest = json.loads((folder.path / _DONE).read_text(encoding="utf-8"))["asked"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return read_table(folder.path) if finished_digest == folder.request_digest else None


def mark_unfinished(folder: Folder) -> None:
    """Make the table of the folder, which stays, count as unfinished."""
    (folder.path / _DONE).unlink(missing_ok=True)


def read_table(path: Path) -> Table:
    """Return the table in *path*, a bench's folder.

    Raises:
        FileError: there is none, or it is damaged.
    """
    steady, timed = _read(path / _TABLE), _read(path / _TIMING)
    timed_cells = {(line.group, line.key): line.cells for line in timed.lines}
    lines = tuple(
        Line(
            line.key,
            line.group,
            line.title,
            {**line.cells, **timed_cells.get((line.group, line.key), {})},
            line.reference,
        )
        for line in steady.lines
    )
    return replace(steady, heads=_in_order(steady.heads, timed.heads), lines=lines)


def _in_order(steady: tuple[Head, ...], timed: tuple[Head, ...]) -> tuple[Head, ...]:
    """Insert the measured columns after the background's plausibility, as in the paper."""
    index = next((k + 1 for k, head in enumerate(steady) if head.key == "veh_rate"), len(steady))
    return (*steady[:index], *timed, *steady[index:])


def _read(path: Path) -> Table:
    adapter: TypeAdapter[Any] = TypeAdapter(Table)
    try:
        table: Table = adapter.validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise FileError(
            path, f"cannot be read ({str(error).splitlines()[0]})", "run the bench again"
        ) from None
    return table
