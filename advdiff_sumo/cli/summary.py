"""The table at the end of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from advdiff_sumo.report.run_summary import summary_figures, summary_lines


def print_summary(console: Console, folder: Path, missing: int) -> None:
    """Print what the run in *folder* came to; *missing* episodes could not be made."""
    rows = pq.read_table(folder / "episodes.parquet").to_pylist()
    timing = pq.read_table(folder / "timing.parquet").to_pylist()
    table = Table(
        title=f"{len(rows)} episodes, rates with 95 % Wilson intervals",
        title_justify="left",
        show_header=False,
    )
    for name, value in summary_lines(rows, timing):
        table.add_row(name, escape(value))
    console.print(table)
    if missing > 0:
        console.print(f"[yellow]the log held {missing} seed scenes fewer than asked for[/yellow]")
    console.print(f"results: {folder}  ·  look at {folder / 'report.html'}", soft_wrap=True)


def run_object(folder: Path) -> dict[str, Any]:
    """Return what ``--json`` prints of a run or sweep: where its results lie and what it came to."""
    rows = pq.read_table(folder / "episodes.parquet").to_pylist()
    files = {"folder": str(folder.resolve()), "report": str((folder / "report.html").resolve())}
    return files | summary_figures(rows)
