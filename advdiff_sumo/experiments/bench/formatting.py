"""Formats figures as text, the same in every kind of table."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

from advdiff_sumo.experiments.bench.intervals import Difference
from advdiff_sumo.experiments.bench.table import Cell, Head

NOTHING = "–"


def comma_separated(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table as comma-separated values, one line for each row."""
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return sink.getvalue()


def number(value: float | None, head: Head) -> str:
    """Return a figure in printed units; "–" if there is none."""
    return NOTHING if value is None else f"{head.scale * value:.{head.digits}f}"


def interval(low: float | None, high: float | None, head: Head) -> str:
    """Return an interval in brackets; "" if there is none."""
    return "" if low is None or high is None else f"[{number(low, head)}, {number(high, head)}]"


def paper_number(cell: Cell) -> str:
    """Return the paper's figure, which is in printed units already; "" if there is none."""
    return "" if cell.paper is None else f"{cell.paper:g}"


def change(difference: Difference, head: Head) -> str:
    """Return a difference with its sign."""
    return NOTHING if difference.value is None else f"{head.scale * difference.value:+.{head.digits}f}"


def heading(head: Head) -> str:
    """Return a column's title with its unit."""
    return f"{head.title} ({head.unit})" if head.unit else head.title


def p_value(p: float | None) -> str:
    """Return a p value as papers print it."""
    if p is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
