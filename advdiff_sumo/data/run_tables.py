"""The files of a run or sweep, read: one sentence says which of them is missing or damaged."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from advdiff_sumo.core.errors import FileError

RUN_SETTINGS, SWEEP_SETTINGS = "run.toml", "sweep.toml"
#: Folder in a run's that holds its episodes until the last one is there.
RUN_PARTS = "parts"


@dataclass(frozen=True)
class RunTables:
    """The folder of a run or sweep, finished or interrupted.

    Attributes:
        folder: where it lies.
        error: kind of error for a file that cannot be used.
        remedy: what to do about it.
    """

    folder: Path
    error: type[FileError] = FileError
    remedy: str = "give the folder of a finished run or sweep"

    @property
    def is_sweep(self) -> bool:
        """Whether it is a sweep's."""
        return (self.folder / SWEEP_SETTINGS).exists()

    def path(self, table: str) -> Path:
        """Return where *table* lies."""
        return self.folder / f"{table}.parquet"

    def settings(self) -> dict[str, Any]:
        """Return the content of ``sweep.toml`` or ``run.toml``.

        Raises:
            FileError: it is missing or damaged.
        """
        path = self.folder / (SWEEP_SETTINGS if self.is_sweep else RUN_SETTINGS)
        try:
            return tomllib.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise self.error(path, "is missing", self.remedy) from None
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise self.error(path, f"cannot be read ({_line(error)})", self.remedy) from None

    def columns(self, table: str, needed: Iterable[str] = ()) -> set[str]:
        """Return the columns that *table* has.

        Raises:
            FileError: it is missing or damaged, or lacks one that is *needed*.
        """
        path = self.path(table)
        try:
            present = set(pq.read_schema(path).names)
        except (OSError, pa.ArrowException) as error:
            raise self._unusable(path, error) from None
        lacking = [name for name in needed if name not in present]
        if lacking:
            remedy = "repeat the run with this version of advdiff-sumo"
            raise self.error(path, f"lacks the columns {', '.join(lacking)}", remedy)
        return present

    def rows(
        self,
        table: str,
        columns: Iterable[str] | None = None,
        episode: int | None = None,
        schema: pa.Schema | None = None,
    ) -> pa.Table:
        """Return *columns* of *table*, or all, of one *episode*, or of all; with *schema*, what it lacks is null.

        Raises:
            FileError: it is missing or damaged.
        """
        path = self.path(table)
        chosen = None if episode is None else pc.field("episode") == episode
        try:
            named = None if columns is None else [*columns]
            return pq.read_table(path, columns=named, filters=chosen, schema=schema)
        except (OSError, pa.ArrowException) as error:
            raise self._unusable(path, error) from None

    def all_episodes(self) -> list[dict[str, Any]]:
        """Return the rows of ``episodes``; of those that failed before they had one, what ``failures`` tells.

        Raises:
            FileError: a table is missing or damaged.
        """
        rows: list[dict[str, Any]] = self.rows("episodes").to_pylist()
        return sorted([*rows, *self.unstarted(rows)], key=lambda row: int(row["episode"]))

    def unstarted(self, rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Return of each failed episode that has none of *rows* its number, end, and why it failed."""
        if not self.path("failures").exists():
            return []
        known = {int(row["episode"]) for row in rows}
        return [
            {
                "episode": failure["episode"],
                "end": "failed",
                "failure_kind": failure["kind"],
                "failure_message": failure["message"],
            }
            for failure in self.rows("failures").to_pylist()
            if int(failure["episode"]) not in known
        ]

    def _unusable(self, path: Path, error: Exception) -> FileError:
        missing = isinstance(error, FileNotFoundError)
        return self.error(path, "is missing" if missing else f"is damaged ({_line(error)})", self.remedy)


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
