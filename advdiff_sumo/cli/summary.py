"""Print the summary of a run: its table, failures and report."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from advdiff_sumo.core.errors import UNEXPLAINED_KINDS
from advdiff_sumo.core.wording import counted
from advdiff_sumo.data.run_tables import RunTables
from advdiff_sumo.report.run_summary import summary_figures, summary_lines

UNEXPLAINED = "neither a plug-in nor the input explains this: please report it, with that command and the net"
_FAILURE_TIME = re.compile(r" (at [\d.]+ s of the episode|before the first step)")


def print_summary(
    console: Console, folder: Path, missing: int, failures: Sequence[Mapping[str, Any]]
) -> None:
    """Print the summary of the run in *folder*.

    Args:
        console: receives the text.
        folder: the run's folder.
        missing: number of episodes for which the driving log had no seed scene.
        failures: rows of ``failures.parquet``.
    """
    tables = RunTables(folder)
    rows, timing = tables.all_episodes(), tables.rows("timing").to_pylist()
    table = Table(
        title=f"{counted(len(rows), 'episode')}, rates with 95 % Wilson intervals",
        title_justify="left",
        show_header=False,
    )
    for name, value in summary_lines(rows, timing, tables.situation()):
        table.add_row(name, value)
    console.print(table)
    if missing > 0:
        console.print(f"the log held {counted(missing, 'seed scene')} fewer than asked for", style="yellow")
    total = len({row["episode"] for row in (*rows, *failures)})  # an episode may have only a row of failures
    for failure, count in _distinct(failures):
        sentence = f"failed, {count} of {total}: {failure['kind']}: {failure['message']}"
        request = f"\n  {UNEXPLAINED}" if failure["kind"] in UNEXPLAINED_KINDS else ""
        command = f"\n  again: {failure['command']}{request}"
        console.print(sentence + command, style="red", soft_wrap=True)
    page = report_of(folder)
    console.print(f"results: {folder}" + (f"  ·  look at {page}" if page else ""), soft_wrap=True)


def report_of(folder: Path) -> Path | None:
    """Return the report of the run or sweep in *folder*; None if there is none."""
    path = folder / "report.html"
    return path if path.exists() else None


def note_old_report(console: Console, folder: Path) -> None:
    """Print a note that the report in *folder*, if there is one, does not contain the latest episodes."""
    if report_of(folder):
        command = f"advdiff-sumo report {shlex.quote(str(folder))}"
        console.print(f"note: report.html is that of before; {command} draws it anew", soft_wrap=True)


def run_object(folder: Path) -> dict[str, Any]:
    """Return the ``--json`` output of a run or sweep: its folder, its report (None if absent) and its figures."""
    rows = RunTables(folder).all_episodes()
    report = report_of(folder)
    files = {"folder": str(folder.resolve()), "report": report and str(report.resolve())}
    return files | summary_figures(rows)


def _distinct(failures: Sequence[Mapping[str, Any]]) -> list[tuple[Mapping[str, Any], int]]:
    """Return the first failure of each reason, and the number of failures with this reason.

    A reason is the kind and the message without the time of the failure.
    """
    reasons = [(row["kind"], _FAILURE_TIME.sub("", row["message"])) for row in failures]
    first = dict(zip(reversed(reasons), reversed(failures), strict=True))
    return [(first[reason], count) for reason, count in Counter(reasons).items()]
