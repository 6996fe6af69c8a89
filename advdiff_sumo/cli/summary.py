"""The table at the end of a run."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import Any

import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table

from advdiff_sumo.metrics.intervals import wilson
from advdiff_sumo.metrics.severity import is_valid_failure


def print_summary(console: Console, folder: Path, missing: int) -> None:
    """Print what the run in *folder* came to; *missing* episodes could not be made."""
    rows = pq.read_table(folder / "episodes.parquet").to_pylist()
    timing = pq.read_table(folder / "timing.parquet").to_pylist()
    finished = [row for row in rows if row["end"] != "failed"]
    table = Table(
        title=f"{len(rows)} episodes, rates with 95 % Wilson intervals",
        title_justify="left",
        show_header=False,
    )
    for name, value in _lines(rows, finished, timing):
        table.add_row(name, value)
    console.print(table)
    if missing > 0:
        console.print(f"[yellow]the log held {missing} seed scenes fewer than asked for[/yellow]")
    console.print(f"results: {folder}  ·  look at {folder / 'report.html'}", soft_wrap=True)


def _lines(
    rows: list[dict[str, Any]], finished: list[dict[str, Any]], timing: list[dict[str, Any]]
) -> list[tuple[str, str]]:
    hits = [row for row in finished if row["target_collision"]]
    lines = [
        ("valid failures", _valid(finished)),
        ("critical near misses", _rate(sum(bool(row["critical"]) for row in finished), len(finished))),
        ("target collides", _rate(len(hits), len(finished))),
        ("… target at fault", _rate(sum(row["at_fault"] == "target" for row in hits), len(finished))),
        ("route completed", _rate(sum(bool(row["route_completed"]) for row in finished), len(finished))),
        ("failed episodes", _rate(len(rows) - len(finished), len(rows))),
        ("median of minimum TTC", _median(finished, "min_ttc_s", "s")),
        ("median of minimum clearance", _median(finished, "min_clearance_m", "m")),
        ("real-time factor (median)", _median(timing, "real_time_factor", "×")),
    ]
    for who in ("target", "background"):
        if any(row[f"{who}_plan_p50_s"] is not None for row in timing):
            p50, p99 = (_median(timing, f"{who}_plan_p{share}_s", "s", "{:.4f}") for share in (50, 99))
            lines.append((f"{who}'s plan, median and 99 %", f"{p50}, {p99}"))
    return lines


def _valid(finished: list[dict[str, Any]]) -> str:
    return _rate(sum(is_valid_failure(row) for row in finished), len(finished))


def _rate(count: int, total: int) -> str:
    if not total:
        return "no episodes"
    low, high = wilson(count, total)
    return f"{100 * count / total:.1f} %  \\[{100 * low:.1f}, {100 * high:.1f}]  {count} of {total}"


def _median(rows: list[dict[str, Any]], column: str, unit: str, form: str = "{:.2f}") -> str:
    values = [row[column] for row in rows if row[column] is not None]
    return f"{form.format(median(values))} {unit}" if values else "–"
