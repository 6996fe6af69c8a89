"""``advdiff-sumo compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from advdiff_sumo.cli.terminal import terminal

if TYPE_CHECKING:
    from advdiff_sumo.sweep.paired import Comparison


def compare(
    first: Annotated[Path, typer.Argument(help="Folder of a run or sweep.", show_default=False)],
    second: Annotated[Path, typer.Argument(help="Folder of another, or the same.", show_default=False)],
    choose_a: Annotated[
        list[str] | None, typer.Option("--a", help="Of the first only episodes with COLUMN=VALUE.")
    ] = None,
    choose_b: Annotated[list[str] | None, typer.Option("--b", help="The same for the second.")] = None,
) -> None:
    """Compare two runs or sweeps over the same seed scenes, episode by episode.

    advdiff-sumo compare runs/planners runs/planners --a target=IDM --b target=lane_graph

    Rates: exact McNemar test, and the difference with a bootstrap interval that draws whole seed scenes.
    """
    from advdiff_sumo.experiments.folder_rows import rows_of_folder  # late: --help is quick
    from advdiff_sumo.sweep.paired import choose
    from advdiff_sumo.sweep.paired import compare as paired

    sides = []
    for folder, conditions, what in ((first, choose_a, "--a"), (second, choose_b, "--b")):
        sides.append(choose(rows_of_folder(folder).episodes, conditions or [], what))
    _print(terminal(), paired(sides[0], sides[1]))


def _print(console: Console, comparison: Comparison) -> None:
    from advdiff_sumo.cli.sweep_results import rate_text

    title = f"{comparison.pairs} pairs of episodes from {comparison.scenes} seed scenes; rates in %"
    table = Table(title=title, title_justify="left")
    for name in ("", "A", "B", "A only", "B only", "B − A, 95 % bootstrap", "McNemar p"):
        table.add_column(name)
    for name, change in comparison.rates.items():
        gap = (change.b.share or 0.0) - (change.a.share or 0.0)
        table.add_row(
            name,
            rate_text(change.a),
            rate_text(change.b),
            str(change.only_a),
            str(change.only_b),
            f"{100 * gap:+.1f} [{100 * change.low:+.1f}, {100 * change.high:+.1f}]",
            f"{change.p:.4f}",
        )
    console.print(table)
    values = Table(title="means of the differences B − A", title_justify="left")
    for name in ("", "pairs", "mean", "95 % bootstrap"):
        values.add_column(name)
    for name, value in comparison.values.items():
        values.add_row(name, str(value.pairs), f"{value.mean:+.3f}", f"[{value.low:+.3f}, {value.high:+.3f}]")
    if comparison.values:
        console.print(values)
    if comparison.unpaired:
        console.print(f"{comparison.unpaired} episodes have no finished counterpart")
