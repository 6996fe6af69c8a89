"""The one file of a finished episode: its rows of every table, or why there are none."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from advdiff_sumo.sweep.tasks import Failed

_FAILURE, _EPISODES = "failure.json", "episodes.parquet"
_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class StoredEpisode:
    """What one episode came to.

    Attributes:
        tables: its rows by table; empty when it never finished.
        failed: why it failed, if it did; an episode in which the planner raised has rows too.
    """

    tables: Mapping[str, pa.Table]
    failed: Failed | None

    def to_bytes(self) -> bytes:
        """Return the file's content; the same part gives the same bytes."""
        entries = {f"{name}.parquet": _parquet(table) for name, table in self.tables.items()}
        if self.failed is not None:
            entries[_FAILURE] = json.dumps(asdict(self.failed)).encode()
        return pack(entries)

    @staticmethod
    def from_bytes(content: bytes) -> StoredEpisode:
        """Return the part of :meth:`to_bytes`."""
        entries = unpack(content)
        failure = entries.pop(_FAILURE, None)
        tables = {name.removesuffix(".parquet"): _table(entry) for name, entry in entries.items()}
        return StoredEpisode(tables, None if failure is None else Failed(**json.loads(failure)))

    @staticmethod
    def glance(content: bytes) -> tuple[dict[str, Any] | None, Failed | None]:
        """Return the row of ``episodes`` and the failure of a part, without reading its other tables."""
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = set(archive.namelist())
            row = failed = None
            if _EPISODES in names:
                (row,) = _table(archive.read(_EPISODES)).to_pylist()
            if _FAILURE in names:
                failed = Failed(**json.loads(archive.read(_FAILURE)))
        return row, failed


def pack(entries: Mapping[str, bytes]) -> bytes:
    """Return an archive of *entries* that does not tell when it was made."""
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_STORED) as archive:
        for name, content in entries.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), content)
    return sink.getvalue()


def unpack(content: bytes) -> dict[str, bytes]:
    """Return the entries of :func:`pack`."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _parquet(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


def _table(content: bytes) -> pa.Table:
    """Return what :func:`_parquet` was made of.

    ``pq.read_table`` imports more of PyArrow when it is first called, and loses a Ctrl-C that comes meanwhile; threads
    that have just read can abort a process that ends (apache/arrow#34314).
    """
    return pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
