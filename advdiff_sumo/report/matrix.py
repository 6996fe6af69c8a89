"""Makes the tables of a sweep.

They are the rates of each target in each background and situation, and the archive: which encounters occurred, and in
which of them each target failed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from advdiff_sumo.metrics.archive import MANOEUVRES, ArchiveCell, Elite, archive
from advdiff_sumo.metrics.severity import broke_rule, has_outcome, is_failure, is_valid_failure
from advdiff_sumo.metrics.statistics import Rate
from advdiff_sumo.report.folder import Row
from advdiff_sumo.report.labels import Labels


@dataclass(frozen=True)
class MatrixCell:
    """One target in one column.

    Attributes:
        valid: valid failures.
        collisions: collisions of the target.
        at_fault: those that it caused.
        offences: episodes in which it broke a rule.
        failed: failed episodes.
    """

    valid: Rate
    collisions: Rate
    at_fault: Rate
    offences: Rate
    failed: Rate


@dataclass(frozen=True)
class Matrix:
    """A table of targets (rows) and backgrounds or situations (columns).

    Attributes:
        targets: labels of the rows.
        columns: labels of the columns.
        cells: rows of cells; None for a pair that was not run.
        totals: each target in all columns together.
    """

    targets: tuple[str, ...]
    columns: tuple[str, ...]
    cells: tuple[tuple[MatrixCell | None, ...], ...]
    totals: tuple[MatrixCell | None, ...]

    @property
    def is_single(self) -> bool:
        """Whether there is at most one cell, whose figures are those of the headline."""
        return len(self.targets) * len(self.columns) <= 1


def matrix_of(rows: Sequence[Row], labels: Labels) -> Matrix:
    """Return the matrix of targets and backgrounds of *rows* of ``episodes.parquet``."""
    return _matrix(rows, labels, labels.background)


def situations_of(rows: Sequence[Row], labels: Labels) -> Matrix | None:
    """Return the matrix of targets and situations of *rows* of ``episodes.parquet``; None if all have the same one."""
    matrix = _matrix(rows, labels, lambda row: str(row.get("situation")))
    return matrix if len(matrix.columns) > 1 else None


def _matrix(rows: Sequence[Row], labels: Labels, column_of: Callable[[Row], str]) -> Matrix:
    """Return the matrix of *rows*; its targets and columns are in the order of their first episodes."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((labels.target(row), column_of(row)), []).append(row)
    targets = tuple(dict.fromkeys(target for target, _ in groups))
    columns = tuple(dict.fromkeys(column for _, column in groups))
    cells = tuple(tuple(_cell(groups.get((target, column))) for column in columns) for target in targets)
    totals = tuple(
        _cell([row for key, own in groups.items() if key[0] == target for row in own]) for target in targets
    )
    return Matrix(targets, columns, cells, totals)


def _cell(rows: Sequence[Row] | None) -> MatrixCell | None:
    if not rows:
        return None
    counted = [row for row in rows if has_outcome(row)]
    has_collided = [bool(row["target_collision"]) for row in counted]
    is_at_fault = [row["at_fault"] == "target" for row in counted]
    valid = [is_valid_failure(row) for row in counted if row["valid_failure"] is not None]
    return MatrixCell(
        valid=Rate.of_flags(valid),
        collisions=Rate.of_flags(has_collided),
        at_fault=Rate.of_flags(is_at_fault),
        offences=Rate.of_flags([broke_rule(row) for row in counted if row["offences"] is not None]),
        failed=Rate.of_flags([is_failure(row) for row in rows]),
    )


@dataclass(frozen=True)
class ArchiveLine:
    """One line of an archive.

    Attributes:
        kind: of the attack.
        approach: direction from which the other party came.
        elites: contents of the cells, in the order of ``MANOEUVRES``; None for an empty cell.
    """

    kind: str
    approach: str
    elites: tuple[Elite | None, ...]


@dataclass(frozen=True)
class ArchiveTable:
    """The archive of one target.

    Attributes:
        target: its label.
        filled: number of cells with a valid failure.
        met: number of cells with an episode.
        lines: of the table.
    """

    target: str
    filled: int
    met: int
    lines: tuple[ArchiveLine, ...]


def archives_of(rows: Sequence[Row], labels: Labels) -> list[ArchiveTable]:
    """Return the archive of every target that a background attacked; none if the rows have no kind of attack.

    Args:
        rows: of ``episodes.parquet``.
        labels: names of the targets.
    """
    by_target: dict[str, list[Row]] = {}
    for row in rows:
        if row["attack_kind"] is not None:
            by_target.setdefault(labels.target(row), []).append(row)
    tables = [_table(target, archive(target_rows)) for target, target_rows in by_target.items()]
    return [table for table in tables if table.lines]


def _table(target: str, cells: dict[ArchiveCell, Elite]) -> ArchiveTable:
    lines = dict.fromkeys((cell.kind, cell.approach) for cell in cells)
    return ArchiveTable(
        target,
        filled=sum(elite.valid > 0 for elite in cells.values()),
        met=len(cells),
        lines=tuple(
            ArchiveLine(*line, tuple(cells.get(ArchiveCell(*line, name)) for name in MANOEUVRES))
            for line in lines
        ),
    )
