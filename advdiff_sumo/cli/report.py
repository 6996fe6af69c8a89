"""``advdiff-sumo report``: write the page of a run or sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    run: Annotated[Path, typer.Argument(help="Folder of a run or sweep.", show_default=False)],
) -> None:
    """Write the page report.html into the folder of a run or sweep, interrupted ones too.

    advdiff-sumo report runs/planners

    One file that opens offline: rates with intervals, targets × backgrounds, the map, and a player for each episode.
    """
    from advdiff_sumo.experiments.folder_rows import put_together  # late: --help needs no plots
    from advdiff_sumo.report.page import write_report

    put_together(run)
    typer.echo(str(write_report(run)))
