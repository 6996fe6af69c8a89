"""Query the tables of a run or sweep by SQL, through DuckDB."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa

from advdiff_sumo.core.errors import ConfigError, MissingExtraError
from advdiff_sumo.metrics.arrow_tables import schema_of
from advdiff_sumo.sweep.sweep_columns import SWEEP_TABLES


def query(folder: Path, sql: str, instead: Mapping[str, pa.Table]) -> pa.Table:
    """Return the result of *sql* over views of the tables in *folder*, such as episodes and states.

    Args:
        folder: folder of a run or sweep.
        sql: the query.
        instead: tables by name that replace those in the folder.

    Raises:
        MissingExtraError: DuckDB is not installed.
        ConfigError: the query is wrong.
    """
    try:
        import duckdb  # late: an extra
    except ImportError:
        raise MissingExtraError("results --sql", "sql") from None
    with duckdb.connect(":memory:", config={"threads": 1}) as database:
        for name, columns in SWEEP_TABLES.items():
            file = folder / f"{name}.parquet"
            # an unfinished run, or one of an earlier version, lacks some tables
            if name in instead or not file.exists():
                database.register(name, instead.get(name, schema_of(columns).empty_table()))
            else:
                database.read_parquet(str(file)).create_view(name)
        try:
            result = database.sql(sql)
            if result is None:
                raise ConfigError(f"--sql: {sql} asks for nothing; begin with select")
            table: pa.Table = result.to_arrow_table()
            return table
        except duckdb.Error as error:
            raise ConfigError(f"--sql: {error}") from None
