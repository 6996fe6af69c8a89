"""Convert a finished episode to and from its one file: its rows of every table, and its failure."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.sweep.tasks import Failed

_FAILURE, _EPISODES = "failure.json", "episodes.parquet"
_TIME_STAMP = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class StoredEpisode:
    """Stored form of one episode.

    Attributes:
        tables: its rows by table; empty if it never finished.
        failed: why it failed; None if it did not. An episode whose planner raised has rows, too.
    """

    tables: Mapping[str, pa.Table]
    failed: Failed | None

    def to_bytes(self) -> bytes:
        """Return the file's content; equal episodes give equal bytes."""
        entries = {f"{name}.parquet": _parquet(table) for name, table in self.tables.items()}
        if self.failed is not None:
            entries[_FAILURE] = json.dumps(asdict(self.failed)).encode()
        return pack(entries)

    @staticmethod
    def from_bytes(content: bytes) -> StoredEpisode:
        """Return the episode written by :meth:`to_bytes`."""
        entries = unpack(content)
        failure = entries.pop(_FAILURE, None)
        tables = {name.removesuffix(".parquet"): _table(entry) for name, entry in entries.items()}
        return StoredEpisode(tables, None if failure is None else Failed(**json.loads(failure)))

    @staticmethod
    def row_and_failure(content: bytes) -> tuple[dict[str, Any] | None, Failed | None]:
        """Return the row of ``episodes`` and the failure, without reading the other tables."""
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = set(archive.namelist())
            row = failed = None
            if _EPISODES in names:
                (row,) = _table(archive.read(_EPISODES)).to_pylist()
            if _FAILURE in names:
                failed = Failed(**json.loads(archive.read(_FAILURE)))
        return row, failed


def with_output(content: bytes, output: str) -> bytes:
    """Return a stored episode whose failure has *output* as its ``log_tail``, if it has no other."""
    failed = StoredEpisode.row_and_failure(content)[1] if output else None
    if failed is None or failed.log_tail:
        return content
    return replace(StoredEpisode.from_bytes(content), failed=replace(failed, log_tail=output)).to_bytes()


def pack(entries: Mapping[str, bytes]) -> bytes:
    """Return an archive of *entries* without time stamps."""
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_STORED) as archive:
        for name, content in entries.items():
            archive.writestr(zipfile.ZipInfo(name, _TIME_STAMP), content)
    return sink.getvalue()


def unpack(content: bytes) -> dict[str, bytes]:
    """Return the entries of an archive made by :func:`pack`."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _parquet(table: pa.Table) -> bytes:
    """Return *table* as the bytes of a Parquet file."""
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


def _table(content: bytes) -> pa.Table:
    """Return the table written by :func:`_parquet`.

    ``pq.read_table`` imports more of PyArrow at its first call, and loses a Ctrl-C that arrives then. Reader threads
    can abort a process that ends shortly after reading (apache/arrow#34314).
    """
    return pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
