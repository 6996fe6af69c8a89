"""SQL over the tables of a run or sweep, through DuckDB."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa

from advdiff_sumo.core.errors import ConfigError, MissingExtraError
from advdiff_sumo.metrics.arrow_tables import schema_of
from advdiff_sumo.sweep.sweep_columns import SWEEP_TABLES


def query(folder: Path, sql: str, instead: Mapping[str, pa.Table]) -> pa.Table:
    """Return the answer to *sql* over the views of the tables in *folder*, such as episodes and states.

    Args:
        folder: of a run or sweep.
        sql: what is asked.
        instead: tables that stand for those of their names in the folder.

    Raises:
        MissingExtraError: DuckDB is not installed.
        ConfigError: the query is wrong.
    """
    try:
        import duckdb  # late: an extra
    except ImportError:
        raise MissingExtraError("results --sql", "sql") from None
    with duckdb.connect(":memory:", config={"threads": 1}) as base:
        for name, columns in SWEEP_TABLES.items():
            file = folder / f"{name}.parquet"
            if (
                name in instead or not file.exists()
            ):  # a run that is going on, or of an earlier version, lacks some
                base.register(name, instead.get(name, schema_of(columns).empty_table()))
            else:
                base.read_parquet(str(file)).create_view(name)
        try:
            answer = base.sql(sql)
            if answer is None:
                raise ConfigError(f"--sql: {sql} asks for nothing; begin with select")
            table: pa.Table = answer.to_arrow_table()
            return table
        except duckdb.Error as error:
            raise ConfigError(f"--sql: {error}") from None
