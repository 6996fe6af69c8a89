"""Writes a table of many episodes: whole or not at all, with the same bytes for the same rows."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.core.whole_file import aside_of, settle
from advdiff_sumo.sweep.sweep_files import unwritable


class TableWriter:
    """One table that is being written, aside first.

    Attributes:
        path: its file.
        schema: of its columns.
        rows_together: they are written in groups of so many; 0: each table that is added is a group.
    """

    def __init__(self, path: Path, schema: pa.Schema, rows_together: int) -> None:
        self.path, self.schema, self.rows_together = path, schema, rows_together
        self.aside = aside_of(self.path)
        self._held: list[pa.Table] = []
        self._rows = 0
        self._writer: Any = None

    def __enter__(self) -> TableWriter:
        try:
            self._writer = pq.ParquetWriter(self.aside, self.schema, compression="zstd")
        except OSError as error:
            raise unwritable(self.path, error) from None
        return self

    def add(self, table: pa.Table) -> None:
        """Take rows; they are written in groups of a size that does not depend on when they came."""
        self._held.append(table)
        self._rows += table.num_rows
        if self._rows >= self.rows_together:
            self._flush()

    def _flush(self) -> None:
        if self._held:
            try:
                self._writer.write_table(pa.concat_tables(self._held).combine_chunks())
            except OSError as error:
                raise unwritable(self.path, error) from None
        self._held, self._rows = [], 0

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if kind is None:
                self._flush()
            self._writer.close()
            if kind is None:
                settle(self.aside, self.path)
                return
        except OSError as failed:
            if kind is None:
                raise unwritable(self.path, failed) from None
        finally:
            with contextlib.suppress(OSError):
                self.aside.unlink()
