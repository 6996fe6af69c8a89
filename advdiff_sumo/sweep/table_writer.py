"""Write a table of many episodes: completely or not at all, with the same bytes for the same rows."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.core.whole_file import arrow_path, aside_of, settle
from advdiff_sumo.sweep.sweep_files import unwritable


class TableWriter:
    """A table being written, into a temporary file first.

    Attributes:
        path: final file.
        schema: schema of the table.
        rows_together: least number of rows in a group; 0: each added table is a group.
    """

    def __init__(self, path: Path, schema: pa.Schema, rows_together: int) -> None:
        self.path, self.schema, self.rows_together = path, schema, rows_together
        self.aside = aside_of(self.path)
        self._pending: list[pa.Table] = []
        self._rows = 0
        self._writer: Any = None

    def __enter__(self) -> TableWriter:
        try:
            self._writer = pq.ParquetWriter(arrow_path(self.aside), self.schema, compression="zstd")
        except OSError as error:
            raise unwritable(self.path, error) from None
        return self

    def add(self, table: pa.Table) -> None:
        """Add rows; the size of the written groups depends on the rows only, not on time."""
        self._pending.append(table)
        self._rows += table.num_rows
        if self._rows >= self.rows_together:
            self._flush()

    def _flush(self) -> None:
        """Write the pending rows as one group."""
        if self._pending:
            try:
                self._writer.write_table(pa.concat_tables(self._pending).combine_chunks())
            except OSError as error:
                raise unwritable(self.path, error) from None
        self._pending, self._rows = [], 0

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if kind is None:
                self._flush()
            self._writer.close()
            if kind is None:
                settle(self.aside, self.path)
                return
        except OSError as os_error:
            if kind is None:
                raise unwritable(self.path, os_error) from None
        finally:
            with contextlib.suppress(OSError):
                self.aside.unlink()
