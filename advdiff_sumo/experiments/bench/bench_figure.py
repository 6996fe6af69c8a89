"""Draws a bench's table as a picture: intervals side by side, a heat map, or curves."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from advdiff_sumo.experiments.bench import formatting
from advdiff_sumo.experiments.bench.table import Cell, Head, Line, Table
from advdiff_sumo.sweep.sweep_files import write_whole

_OURS, _OTHERS, _REFERENCE, _PAPER = "#00796b", "#37474f", "#90a4ae", "#bdbdbd"
_PANELS_PER_ROW = 4
_DPI = 130
_WHITE_TEXT_FROM = 0.7
"""Share of a heat map's highest value above which text is white."""


def draw(path: Path, table: Table) -> None:
    """Draw *table* to *path*, a PNG.

    Raises:
        FileError: it cannot be written.
    """
    kinds = {"transfer": _heat_map, "fewshot": _curves, "defects": _detections}
    figure = kinds.get(table.bench, _intervals)(table)
    sink = io.BytesIO()
    figure.savefig(sink, format="png", metadata={"Software": None})
    write_whole(path, sink.getvalue())


def _intervals(table: Table) -> Figure:
    """Return a panel for each column with each row's figure and interval; the paper's figure is a grey cross."""
    columns = min(_PANELS_PER_ROW, len(table.heads))
    rows = -(-len(table.heads) // columns)
    figure = Figure(
        figsize=(3.4 * columns, rows * (1.0 + 0.27 * len(table.lines))), dpi=_DPI, layout="constrained"
    )
    figure.suptitle(table.title, fontsize=10)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for k, axes in enumerate(panels.flat):
        if k < len(table.heads):
            _panel(axes, table, table.heads[k])
        else:
            axes.set_visible(False)
    return figure


def _panel(axes: Axes, table: Table, head: Head) -> None:
    for row, line in enumerate(table.lines):
        cell = line.cells.get(head.key)
        if cell is not None and cell.found.value is not None:
            _dot(axes, row, cell, head, line)
    labels = [f"{line.group}: {line.title}" if line.group else line.title for line in table.lines]
    axes.set_yticks(range(len(table.lines)), labels, fontsize=7)
    axes.set_ylim(len(table.lines) - 0.5, -0.5)
    axes.set_title(formatting.heading(head), fontsize=8)
    axes.tick_params(axis="x", labelsize=7)
    axes.grid(axis="x", alpha=0.3)


def _dot(axes: Axes, row: int, cell: Cell, head: Head, line: Line) -> None:
    estimate = cell.found
    colour = _REFERENCE if line.reference else _OURS if line.key == "diffusion" else _OTHERS
    value = head.scale * (estimate.value or 0.0)
    if estimate.low is not None and estimate.high is not None:
        axes.plot(
            [head.scale * estimate.low, head.scale * estimate.high], [row, row], color=colour, linewidth=1.5
        )
    axes.plot([value], [row], "o", color=colour, markersize=4)
    if cell.paper is not None and cell.paper < 100.0 * max(value, 1.0):
        axes.plot([cell.paper], [row], "x", color=_PAPER, markersize=5)


def _heat_map(table: Table) -> Figure:
    """Return the target's collision rates as a heat map: what the policy was adapted to (rows) by target (columns)."""
    heads = [head for head in table.heads if head.key.endswith(":av_rate")]
    values = np.array([[_value(line, head) for head in heads] for line in table.lines])
    size = (1.6 + 1.3 * len(heads), 1.6 + 0.4 * len(table.lines))
    figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
    axes = figure.subplots()
    white_from = _WHITE_TEXT_FROM * np.nan_to_num(values).max()
    axes.imshow(np.nan_to_num(values), cmap="YlOrRd", aspect="auto", vmin=0.0)
    for row, line in enumerate(table.lines):
        for column, head in enumerate(heads):
            cell = line.cells.get(head.key)
            if cell is not None:
                paper = formatting.paper_number(cell)
                text = formatting.number(cell.found.value, head) + (f"\n({paper})" if paper else "")
                colour = "white" if values[row, column] > white_from else "black"
                axes.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    axes.set_yticks(range(len(table.lines)), [line.title for line in table.lines], fontsize=7)
    axes.set_xticks(range(len(heads)), [head.title.partition(":")[0] for head in heads], fontsize=7)
    axes.set_title(f"{table.title}\nAV CR in %, the paper's in brackets", fontsize=8)
    return figure


def _detections(table: Table) -> Figure:
    """Return the rates of valid failures as a heat map: planted defects (rows) by background (columns)."""
    lines = [line for line in table.lines if line.key != "score"]
    values = np.array([[_value(line, head) for head in table.heads] for line in lines])
    size = (max(3.0 + 1.1 * len(table.heads), 6.0), 1.6 + 0.27 * len(lines))
    figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
    axes = figure.subplots()
    highest = max(float(np.nan_to_num(values).max()), 1.0)
    axes.imshow(np.nan_to_num(values), cmap="YlOrRd", aspect="auto", vmin=0.0, vmax=highest)
    for row, line in enumerate(lines):
        for column, head in enumerate(table.heads):
            cell = line.cells.get(head.key)
            if cell is not None and cell.found.n:
                text = formatting.number(cell.found.value, head) + (" ★" if cell.best else "")
                colour = "white" if values[row, column] > _WHITE_TEXT_FROM * highest else "black"
                weight = "bold" if cell.best else "normal"
                axes.text(
                    column, row, text, ha="center", va="center", fontsize=7, color=colour, weight=weight
                )
    axes.set_yticks(range(len(lines)), [f"{line.group}: {line.title}" for line in lines], fontsize=7)
    axes.set_xticks(range(len(table.heads)), [head.title for head in table.heads], fontsize=7, rotation=30)
    axes.set_title(f"{table.title}\nvalid failures in %, a star where the defect is detected", fontsize=8)
    return figure


def _curves(table: Table) -> Figure:
    """Return a panel for each group with a curve for each row: collision rate over steps, its interval as a band."""
    groups = tuple(dict.fromkeys(line.group for line in table.lines))
    figure = Figure(figsize=(1.5 + 4.5 * len(groups), 4.0), dpi=_DPI, layout="constrained")
    figure.suptitle(table.title, fontsize=9)
    panels = figure.subplots(1, len(groups), squeeze=False, sharey=True)[0]
    for group, axes in zip(groups, panels, strict=True):
        for line in table.lines:
            if line.group == group:
                _curve(axes, line, table.heads)
        axes.set_title(group, fontsize=9)
        axes.set_xlabel("warm-up steps")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("collision rate (%)")
    panels[-1].legend(fontsize=8)
    return figure


def _curve(axes: Axes, line: Line, heads: Sequence[Head]) -> None:
    steps = [int(head.key.rpartition("_")[2]) for head in heads]
    estimates = [line.cells[head.key].found for head in heads]
    value, low, high = (
        [np.nan if part is None else 100.0 * part for part in parts]
        for parts in zip(
            *((estimate.value, estimate.low, estimate.high) for estimate in estimates), strict=True
        )
    )
    (curve,) = axes.plot(steps, value, marker="o", markersize=4, label=line.title)
    axes.fill_between(steps, low, high, color=curve.get_color(), alpha=0.12)


def _value(line: Line, head: Head) -> float:
    cell = line.cells.get(head.key)
    return np.nan if cell is None or cell.found.value is None else head.scale * cell.found.value
