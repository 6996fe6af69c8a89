"""A bench's table as values, before it is printed, drawn or written."""

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
        title: what is printed.
        unit: its unit; "" for none.
        scale: what figures are multiplied with for printing: 100 for percent.
        digits: behind the point.
        better: which figures are better for a background policy; "" where that makes no sense.
        measured: wall-clock, which differs from run to run; kept out of the files that do not.
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
        found: our own, unscaled.
        paper: the paper's, in printed units; None where it has none.
        best: the best of its column among the rows that compete.
    """

    found: Estimate
    paper: float | None = None
    best: bool = False


@dataclass(frozen=True)
class Line:
    """A row.

    Attributes:
        key: its name in files.
        group: what stands before it, such as the target.
        title: what is printed.
        cells: by column; those without a figure are missing.
        reference: it is looked at beside the others and does not compete.
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
    """A bench's result.

    Attributes:
        bench: its verb.
        title: what it is.
        heads: columns.
        lines: rows.
        gaps: paired differences to the best rival.
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
    """What one row's cells are computed from.

    Attributes:
        key: of the row.
        group: of the row.
        title: of the row.
        samples: by column.
        reference: it does not compete.
        ours: it is the method that the others are held against.
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
    """Return the paper's own table for *bench*: row → column → figure, in percent, divergences times a hundred."""
    text = files(__package__).joinpath("paper.json").read_text(encoding="utf-8")
    rows: Mapping[str, Mapping[str, float]] = json.loads(text)[bench]["rows"]
    return rows


def lines_of(
    heads: Sequence[Head], rows: Sequence[RowSamples], paper: Mapping[str, Mapping[str, float]]
) -> tuple[Line, ...]:
    """Return the rows with their intervals; the best of each group's competing rows is marked.

    Args:
        heads: columns.
        rows: what the cells are computed from.
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

    def cell(row: RowSamples, key: str, one: Estimate) -> Cell:
        wins = not row.reference and one.value is not None and one.value == best[row.group, key]
        return Cell(one, paper.get(row.name, {}).get(key), wins)

    return tuple(
        Line(
            row.key,
            row.group,
            row.title,
            {key: cell(row, key, one) for key, one in estimates[row.name].items()},
            row.reference,
        )
        for row in rows
    )


def gaps_of(heads: Sequence[Head], rows: Sequence[RowSamples]) -> tuple[Gap, ...]:
    """Return ours less the others: in the first column each of them, in the rest the best rival."""
    gaps = []
    for group in dict.fromkeys(row.group for row in rows):
        here = [row for row in rows if row.group == group]
        ours = next((row for row in here if row.ours), None)
        if ours is None:
            continue
        others = [row for row in here if not row.ours]
        for head in heads:
            best = _best_row(head, [row for row in others if not row.reference])
            rivals = others if head is heads[0] else [best] if best is not None else []
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
    known = [(estimate(row.samples[head.key]).value, row) for row in rivals if head.key in row.samples]
    values = [(value, row) for value, row in known if value is not None]
    pick = max if head.better == "high" else min
    return pick(values, key=lambda one: one[0])[1] if values else None


def _best_value(head: Head, rows: Sequence[Mapping[str, Estimate]]) -> float | None:
    values = [row[head.key].value for row in rows if head.key in row]
    known = [value for value in values if value is not None]
    if not known or not head.better or len(known) < 2:
        return None
    return max(known) if head.better == "high" else min(known)
