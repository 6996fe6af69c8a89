"""Make Arrow schemas and tables from columns and rows, and upgrade tables of earlier versions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa

from advdiff_sumo.metrics.columns import LATER_COLUMNS, Column

_ARROW_TYPES = {"str": pa.string(), "int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_()}


def schema_of(columns: Mapping[str, Column]) -> pa.Schema:
    """Return the Arrow schema of *columns*."""
    return pa.schema([pa.field(name, _ARROW_TYPES[column.dtype]) for name, column in columns.items()])


def upgraded_table(table: pa.Table, columns: Mapping[str, Column]) -> pa.Table:
    """Return *table* with missing *columns* of later versions appended, empty."""
    for name in columns:
        if name in LATER_COLUMNS and name not in table.column_names:
            table = table.append_column(name, pa.nulls(table.num_rows))
    return table


def table_of(rows: list[dict[str, Any]], columns: Mapping[str, Column]) -> pa.Table:
    """Return *rows* as a table of *columns*."""
    return pa.Table.from_pylist(rows, schema=schema_of(columns))
