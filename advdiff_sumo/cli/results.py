"""``advdiff-sumo results``: print the results of a run or sweep, or query its tables."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from advdiff_sumo.cli.fitted_table import FittedTable
from advdiff_sumo.cli.sweep_flags import FailIf, JUnit
from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.core.errors import ConfigError


class Form(StrEnum):
    """Format of the answer to a query."""

    table = "table"
    csv = "csv"
    json = "json"


def results(
    folder: Annotated[
        Path, typer.Argument(help="Folder of a run or sweep, finished or not.", show_default=False)
    ],
    sql: Annotated[
        str | None,
        typer.Option(
            help="Query over the tables: episodes, states, collisions, failures … (needs the extra sql)."
        ),
    ] = None,
    form: Annotated[Form, typer.Option("--format", help="Of the answer to --sql.")] = Form.table,
    junit: JUnit = None,
    fail_if: FailIf = None,
) -> None:
    """Print the results of a run or sweep: rates, findings, worst episodes, coverage.

    advdiff-sumo results runs/planners --sql "select target, avg(target_collision::int) from episodes group by 1"

    Without --sql: rates with intervals, failures, findings (near-duplicates among the collisions taken as one), the
    twenty worst episodes, and coverage. Works while a sweep is running, too. --fail-if and --junit go without --sql.
    """
    from advdiff_sumo.cli.sweep_results import conclude, condition_of  # late: --help is quick
    from advdiff_sumo.experiments.folder_rows import rows_of_folder

    if sql is not None and (fail_if is not None or junit is not None):
        raise ConfigError("--fail-if and --junit go without --sql; give two commands")
    if sql is None and form is not Form.table:
        raise ConfigError(f"--format {form.value} is of the answer to --sql; add that")
    condition = condition_of(fail_if)
    rows = rows_of_folder(folder)
    console = terminal()
    if sql is None:
        conclude(console, rows, condition, junit)
        return
    from advdiff_sumo.sweep.sql import query

    _write_answer(console, query(folder, sql, rows.tables()), form)


def _write_answer(console: Console, answer: Any, form: Form) -> None:
    """Write *answer*, an Arrow table, to standard output."""
    if form is Form.csv:
        from pyarrow import csv

        csv.write_csv(answer, sys.stdout.buffer)
    elif form is Form.json:
        import json

        typer.echo(json.dumps(answer.to_pylist(), default=str))
    else:
        names = answer.column_names
        table = FittedTable("", names, dispensable=names[:0:-1])
        for row in answer.to_pylist():
            table.add_row(*("" if value is None else str(value) for value in row.values()))
        table.print(console)
