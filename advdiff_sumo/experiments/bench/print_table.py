"""Prints a bench's table on the terminal: figures, intervals, and the paper's figures in grey."""

from __future__ import annotations

from collections.abc import Collection

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from advdiff_sumo.experiments.bench import formatting
from advdiff_sumo.experiments.bench.table import Cell, Head, Line, Table

_WIDEST = 250
_NARROW_COLUMNS = 5


def print_table(console: Console, table: Table, already_shown: Collection[str] = ()) -> None:
    """Print *table*, its differences, and its notes except those in *already_shown*."""
    previous_width = console.width
    console.width = max(previous_width, _width(table))
    console.print(rich_table(table))
    if table.gaps:
        console.print(gap_table(table))
    console.width = previous_width
    for note in (note for note in table.notes if note not in already_shown):
        console.print(note, style="dim", soft_wrap=True)


def rich_table(table: Table) -> RichTable:
    """Return the figures as a table of Rich."""
    printed = RichTable(title=table.title, title_justify="left")
    groups = any(line.group for line in table.lines)
    if groups:
        printed.add_column("target")
    printed.add_column("")
    for head in table.heads:
        printed.add_column(formatting.heading(head), justify="right", no_wrap=True)
    previous_group = None
    for line in table.lines:
        if previous_group is not None and line.group != previous_group:
            printed.add_section()
        label = [line.group if line.group != previous_group else ""] if groups else []
        printed.add_row(*label, _title(line), *(_cell(line.cells.get(h.key), h) for h in table.heads))
        previous_group = line.group
    return printed


def gap_table(table: Table) -> RichTable:
    """Return the differences to the best rival as a table of Rich."""
    printed = RichTable(title="differences, paired by seed scene", title_justify="left")
    for title in ("target", "figure", "this", "less this", "difference", "95 %", "", "scenes"):
        printed.add_column(title, no_wrap=True)
    heads = {head.key: head for head in table.heads}
    for gap in table.gaps:
        head, difference = heads[gap.column], gap.found
        interval = formatting.interval(difference.low, difference.high, head)
        texts = (gap.group, formatting.heading(head), gap.ours, gap.rival)
        printed.add_row(
            *texts,
            formatting.change(difference, head),
            interval,
            formatting.p_value(difference.p),
            str(difference.scenes),
        )
    return printed


def _title(line: Line) -> Text:
    return Text(line.title, style="dim" if line.reference else "")


def _cell(cell: Cell | None, head: Head) -> Text:
    """Return figure, interval, sample size and the paper's figure, each on a line."""
    if cell is None:
        return Text(formatting.NOTHING)
    lines = [Text(formatting.number(cell.found.value, head), style="bold" if cell.best else "")]
    interval = formatting.interval(cell.found.low, cell.found.high, head)
    if interval:
        lines.append(Text(interval))
    if cell.found.n:
        lines.append(Text(f"n {cell.found.n}", style="dim"))
    paper = formatting.paper_number(cell)
    if paper:
        lines.append(Text(f"paper {paper}", style="bright_black"))
    return Text("\n").join(lines)


def _width(table: Table) -> int:
    return min(_WIDEST, 40 + 18 * len(table.heads)) if len(table.heads) > _NARROW_COLUMNS else 130
