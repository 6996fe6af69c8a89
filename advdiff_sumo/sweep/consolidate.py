"""Write the episodes of a sweep into one file a table, in the sweep's order."""

from __future__ import annotations

import contextlib
import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from advdiff_sumo.data.run_tables import RunTables
from advdiff_sumo.metrics.arrow_tables import schema_of, table_of, upgraded_table
from advdiff_sumo.metrics.columns import Column
from advdiff_sumo.sweep.fingerprint import digest
from advdiff_sumo.sweep.job_plan import Job, SweepPlan
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from advdiff_sumo.sweep.sweep_columns import FAILURE_COLUMNS, SWEEP_TABLES, job_row
from advdiff_sumo.sweep.sweep_files import checksum_of, write_whole
from advdiff_sumo.sweep.sweep_store import Store
from advdiff_sumo.sweep.table_writer import TableWriter

_ROWS_A_GROUP = 100_000
_SEAL = "tables.json"  # checksums of the tables, and of the episodes in them


def consolidate(store: Store, plan: SweepPlan) -> int:
    """Write the tables of all stored episodes; return the number of missing episodes.

    The same episodes give the same bytes, independent of workers and order; except for ``timing``.

    Raises:
        FileError: the tables cannot be written.
    """
    missing = 0
    folder = store.path
    with contextlib.ExitStack() as stack:
        writers = {name: stack.enter_context(_writer(folder, name)) for name in SWEEP_TABLES}
        for job in plan.jobs:
            stored = store.read(job.key)
            if stored is None:
                missing += 1
                continue
            for name, table in _rows(stored, job, plan, folder).items():
                writers[name].add(table)
    seal = {
        "episodes": len(plan.jobs),
        "missing": missing,
        "parts": _parts(store, plan),
        "files": {n: checksum_of(folder / f"{n}.parquet") for n in SWEEP_TABLES},
    }
    write_whole(folder / _SEAL, json.dumps(seal, indent=1).encode())
    return missing


def tables_of(store: Store, plan: SweepPlan) -> int:
    """Make sure that the tables are complete; return the number of missing episodes.

    They are written again if one is missing or damaged, or if episodes were added or changed since.
    """
    try:
        seal = json.loads((store.path / _SEAL).read_text(encoding="utf-8"))
        intact = all(
            checksum_of(store.path / f"{name}.parquet") == seal["files"][name] for name in SWEEP_TABLES
        )
    except (OSError, ValueError, KeyError, TypeError):
        intact, seal = False, {}
    missing = sum(not store.has(job.key) for job in plan.jobs)
    if intact and seal.get("parts") == _parts(store, plan) and seal["missing"] == missing:
        return missing
    return consolidate(store, plan)


def tables_are_behind(store: Store) -> bool:
    """Return whether the tables may lack an episode, by modification times, which is faster than reading."""
    try:
        sealed_ns = (store.path / _SEAL).stat().st_mtime_ns
    except OSError:
        return True
    return any(changed_ns > sealed_ns for changed_ns in store.changed_ns())


def _parts(store: Store, plan: SweepPlan) -> str:
    """Return the digest of the stored episodes, in the sweep's order."""
    return digest([store.checksum(job.key) for job in plan.jobs])


def read_rows(folder: Path, table: str) -> list[dict[str, Any]]:
    """Return the rows of a table of a sweep.

    Raises:
        FileError: it is missing or damaged.
    """
    rows: list[dict[str, Any]] = RunTables(folder).rows(table).to_pylist()
    return rows


def _rows(stored: StoredEpisode, job: Job, plan: SweepPlan, folder: Path) -> dict[str, pa.Table]:
    """Return the rows of one episode for each table of the sweep."""
    job_values = job_row(job, plan.options(job))
    tables: dict[str, pa.Table] = {}
    for name, table in stored.tables.items():
        columns = table.drop_columns(["episode"])
        leading = job_values if name == "episodes" else {"episode": job.index}
        tables[name] = _with_leading(columns, leading, SWEEP_TABLES[name])
    if stored.failed is not None:
        command = f"advdiff-sumo replay {job.key} --sweep {shlex.quote(str(folder))}"
        row = {**job_values, **vars(stored.failed), "command": command}
        tables["failures"] = table_of([row], FAILURE_COLUMNS)
    return tables


def _writer(folder: Path, name: str) -> TableWriter:
    """Return a writer for table *name*."""
    return TableWriter(folder / f"{name}.parquet", schema_of(SWEEP_TABLES[name]), _ROWS_A_GROUP)


def _with_leading(table: pa.Table, leading: Mapping[str, Any], columns: Mapping[str, Column]) -> pa.Table:
    """Return *table* with the same *leading* values at the beginning of each row."""
    schema = schema_of(columns)
    count = table.num_rows
    arrays = [
        pa.array(np.full(count, value)) if isinstance(value, int) else pa.array([value] * count, pa.string())
        for value in leading.values()
    ]
    result = pa.table(arrays, names=list(leading))
    for name in table.column_names:
        result = result.append_column(name, table[name])
    return upgraded_table(result, columns).select(schema.names).cast(schema)
