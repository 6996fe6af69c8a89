"""The table of a bench as values, before it is printed, drawn or written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Literal

from advdiff_sumo.experiments.bench.intervals import Difference, Estimate, Sample, difference, estimate

Better = Literal["high", "low", ""]


@dataclass(frozen=True)
class Head:
    """A column.

    Attributes:
        key: its name in files.
        title: printed name.
        unit: its unit; "" for none.
        scale: factor of printed figures: 100 for percent.
        digits: printed after the decimal point.
        better: which figures are better for a background policy; "" if neither.
        measured: a wall-clock time, which differs between runs; it is written to separate files.
    """

    key: str
    title: str
    unit: str = ""
    scale: float = 1.0
    digits: int = 2
    better: Better = ""
    measured: bool = False


@dataclass(frozen=True)
class Cell:
    """A figure.

    Attributes:
        found: our estimate, unscaled.
        paper: the paper's figure, in printed units; None if it has none.
        best: the best of its column among the competing rows of its group.
    """

    found: Estimate
    paper: float | None = None
    best: bool = False


@dataclass(frozen=True)
class Line:
    """A row.

    Attributes:
        key: its name in files.
        group: printed before it, such as the target.
        title: printed name.
        cells: by column; cells without a figure are missing.
        reference: it serves for comparison and does not compete.
    """

    key: str
    group: str
    title: str
    cells: Mapping[str, Cell]
    reference: bool = False


@dataclass(frozen=True)
class Gap:
    """Ours less the best rival, in one column.

    Attributes:
        group: of the rows.
        column: its key.
        ours: title of our row.
        rival: title of the rival's.
        found: the difference, unscaled.
    """

    group: str
    column: str
    ours: str
    rival: str
    found: Difference


@dataclass(frozen=True)
class Table:
    """The result of a bench.

    Attributes:
        bench: its verb.
        title: of the table.
        heads: columns.
        lines: rows.
        gaps: paired differences to rivals.
        notes: sentences below it: definitions, sizes, what is missing.
    """

    bench: str
    title: str
    heads: tuple[Head, ...]
    lines: tuple[Line, ...]
    gaps: tuple[Gap, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class RowSamples:
    """The samples of one row's cells.

    Attributes:
        key: of the row.
        group: of the row.
        title: of the row.
        samples: by column.
        reference: it does not compete.
        ours: it is our method, with which the others are compared.
    """

    key: str
    group: str
    title: str
    samples: Mapping[str, Sample]
    reference: bool = False
    ours: bool = False

    @property
    def name(self) -> str:
        """Group and key."""
        return f"{self.group}/{self.key}" if self.group else self.key


def paper_table(bench: str) -> Mapping[str, Mapping[str, float]]:
    """Return the paper's table for *bench*: row → column → figure; shares in percent, divergences times 100."""
    text = files(__package__).joinpath("paper.json").read_text(encoding="utf-8")
    rows: Mapping[str, Mapping[str, float]] = json.loads(text)[bench]["rows"]
    return rows


def lines_of(
    heads: Sequence[Head], rows: Sequence[RowSamples], paper: Mapping[str, Mapping[str, float]]
) -> tuple[Line, ...]:
    """Return the rows with their intervals; the best of each group's competing rows is marked.

    Args:
        heads: columns.
        rows: samples of the cells.
        paper: the paper's figures, by :attr:`RowSamples.name` and column.
    """
    estimates = {
        row.name: {h.key: estimate(row.samples[h.key]) for h in heads if h.key in row.samples} for row in rows
    }
    best = {
        (group, head.key): _best_value(
            head, [estimates[row.name] for row in rows if row.group == group and not row.reference]
        )
        for group in dict.fromkeys(row.group for row in rows)
        for head in heads
    }

    def cell(row: RowSamples, key: str, found: Estimate) -> Cell:
        is_best = not row.reference and found.value is not None and found.value == best[row.group, key]
        return Cell(found, paper.get(row.name, {}).get(key), is_best)

    return tuple(
        Line(
            row.key,
            row.group,
            row.title,
            {key: cell(row, key, estimate) for key, estimate in estimates[row.name].items()},
            row.reference,
        )
        for row in rows
    )


def gaps_of(heads: Sequence[Head], rows: Sequence[RowSamples]) -> tuple[Gap, ...]:
    """Return our figures less those of others: in the first column of each other row, else of the best rival."""
    gaps = []
    for group in dict.fromkeys(row.group for row in rows):
        group_rows = [row for row in rows if row.group == group]
        ours = next((row for row in group_rows if row.ours), None)
        if ours is None:
            continue
        others = [row for row in group_rows if not row.ours]
        for head in heads:
            best_rival = _best_row(head, [row for row in others if not row.reference])
            rivals = others if head is heads[0] else [best_rival] if best_rival is not None else []
            gaps += [
                _gap(head, ours, rival)
                for rival in rivals
                if {head.key} <= ours.samples.keys() & rival.samples.keys()
            ]
    return tuple(gaps)


def _gap(head: Head, ours: RowSamples, rival: RowSamples) -> Gap:
    change = difference(ours.samples[head.key], rival.samples[head.key])
    return Gap(ours.group, head.key, ours.title, rival.title, change)


def _best_row(head: Head, rivals: Sequence[RowSamples]) -> RowSamples | None:
    if not head.better or head.measured:
        return None
    estimates = [(estimate(row.samples[head.key]).value, row) for row in rivals if head.key in row.samples]
    values = [(value, row) for value, row in estimates if value is not None]
    choose = max if head.better == "high" else min
    return choose(values, key=lambda pair: pair[0])[1] if values else None


def _best_value(head: Head, rows: Sequence[Mapping[str, Estimate]]) -> float | None:
    values = [row[head.key].value for row in rows if head.key in row]
    defined = [value for value in values if value is not None]
    if not defined or not head.better or len(defined) < 2:
        return None
    return max(defined) if head.better == "high" else min(defined)
