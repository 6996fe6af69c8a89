"""``advdiff-sumo verdict``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from advdiff_sumo.cli.terminal import terminal


def verdict(
    folder: Annotated[Path, typer.Argument(help="Folder of a run or sweep.", show_default=False)],
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0: one a core.")] = 0,
    search: Annotated[
        bool,
        typer.Option(
            "--search",
            help="Look for any drive that avoids each collision, knowing what the others will do (seconds each).",
        ),
    ] = False,
) -> None:
    """Judge the collisions of a finished run or sweep: which of them count, and why.

    advdiff-sumo verdict runs/first

    Adds the columns of the verdict to episodes.parquet and collisions.parquet, or brings them up to date, and writes
    the report again. Folders of earlier versions will do; what they do not hold is named in each verdict's sentence.
    """
    from advdiff_sumo.cli.run import progress_bar  # late: --help is quick
    from advdiff_sumo.experiments.judge_folder import open_folder
    from advdiff_sumo.metrics.severity import is_valid_failure
    from advdiff_sumo.report import write_report

    console = terminal()
    judging = open_folder(folder)
    with progress_bar(console) as bar:
        task = bar.add_task("episodes judged", total=judging.count)
        rows = judging.judge(workers or os.cpu_count() or 1, lambda: bar.advance(task), search)
    hits = [row for row in rows if row["target_collision"]]
    valid, critical = sum(map(is_valid_failure, rows)), sum(bool(row["critical"]) for row in rows)
    console.print(f"{len(rows)} episodes, {len(hits)} collisions of the target: {valid} valid failures")
    console.print(f"{critical} critical near misses")
    if search:
        console.print(f"{sum(bool(row['unavoidable']) for row in hits)} unavoidable")
    if (folder / "report.html").exists():
        console.print(f"look at {write_report(folder)}", soft_wrap=True)
