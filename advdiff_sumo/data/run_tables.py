"""Reads the settings and tables of a run or sweep folder; errors name the missing or damaged file."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from advdiff_sumo.core.errors import FileError, first_line
from advdiff_sumo.core.whole_file import arrow_path

RUN_SETTINGS, SWEEP_SETTINGS = "run.toml", "sweep.toml"
#: Folder inside a run folder that holds the finished episodes until the run is complete.
RUN_PARTS = "parts"


@dataclass(frozen=True)
class RunTables:
    """The folder of a run or sweep, finished or interrupted.

    Attributes:
        folder: path of the folder.
        error: class of the errors to raise.
        remedy: remedy that these errors state, but for tables of a sweep, which ``results`` writes again.
    """

    folder: Path
    error: type[FileError] = FileError
    remedy: str = "give the folder of a finished run or sweep"

    @property
    def is_sweep(self) -> bool:
        """Whether it is the folder of a sweep."""
        return (self.folder / SWEEP_SETTINGS).exists()

    def path(self, table: str) -> Path:
        """Return the path of the file of *table*."""
        return self.folder / f"{table}.parquet"

    def settings(self) -> dict[str, Any]:
        """Return the content of ``sweep.toml`` or ``run.toml``.

        Raises:
            FileError: it is missing or damaged.
        """
        path = self.folder / (SWEEP_SETTINGS if self.is_sweep else RUN_SETTINGS)
        try:
            return tomllib.loads(path.read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            raise self.error(path, "is missing", self.remedy) from None
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise self.error(path, f"cannot be read ({first_line(error)})", self.remedy) from None

    def situation(self) -> str:
        """Return the option ``scene.situation`` of a run; "any" for a sweep, whose episodes have a column of it.

        Raises:
            FileError: ``run.toml`` or ``sweep.toml`` is missing or damaged.
        """
        return str(self.settings().get("options", {}).get("scene", {}).get("situation", "any"))

    def columns(self, table: str, needed: Iterable[str] = ()) -> set[str]:
        """Return the names of the columns of *table*.

        Raises:
            FileError: it is missing or damaged, or lacks one of the columns *needed*.
        """
        path = self.path(table)
        try:
            present = set(pq.read_schema(arrow_path(path)).names)
        except (OSError, pa.ArrowException) as error:
            raise self._unusable(path, error) from None
        missing = [name for name in needed if name not in present]
        if missing:
            remedy = "repeat the run with this version of advdiff-sumo"
            raise self.error(path, f"lacks the columns {', '.join(missing)}", remedy)
        return present

    def rows(
        self,
        table: str,
        columns: Iterable[str] | None = None,
        episode: int | None = None,
        schema: pa.Schema | None = None,
    ) -> pa.Table:
        """Return rows of a table.

        Args:
            table: name of the table.
            columns: columns to return; None: all.
            episode: episode whose rows to return; None: all episodes.
            schema: schema of the result; columns that the table lacks are null.

        Raises:
            FileError: it is missing or damaged.
        """
        path = self.path(table)
        filters = None if episode is None else pc.field("episode") == episode
        try:
            names = None if columns is None else [*columns]
            return pq.read_table(arrow_path(path), columns=names, filters=filters, schema=schema)
        except (OSError, pa.ArrowException) as error:
            raise self._unusable(path, error) from None

    def all_episodes(self) -> list[dict[str, Any]]:
        """Return the rows of ``episodes`` and those of :meth:`unstarted`, ordered by episode.

        Raises:
            FileError: a table is missing or damaged.
        """
        rows: list[dict[str, Any]] = self.rows("episodes").to_pylist()
        return sorted([*rows, *self.unstarted(rows)], key=lambda row: int(row["episode"]))

    def unstarted(self, rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Return a short row for each failed episode without one in *rows*: its number, end, and cause of failure."""
        if not self.path("failures").exists():
            return []
        listed = {int(row["episode"]) for row in rows}
        return [
            {
                "episode": failure["episode"],
                "end": "failed",
                "failure_kind": failure["kind"],
                "failure_message": failure["message"],
            }
            for failure in self.rows("failures").to_pylist()
            if int(failure["episode"]) not in listed
        ]

    def _unusable(self, path: Path, error: Exception) -> FileError:
        is_missing = isinstance(error, FileNotFoundError)
        problem = "is missing" if is_missing else f"is damaged ({first_line(error)})"
        again = f"advdiff-sumo results {shlex.quote(str(self.folder))} writes it again"
        return self.error(path, problem, again if self.is_sweep else self.remedy)
