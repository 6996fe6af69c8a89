"""The table of a sweep: how often each target collided in each background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from advdiff_sumo.metrics.severity import is_valid_failure
from advdiff_sumo.metrics.statistics import Rate
from advdiff_sumo.report.folder import Row
from advdiff_sumo.report.labels import Labels


@dataclass(frozen=True)
class MatrixCell:
    """One target in one background: valid failures, collisions of the target, and those that it caused."""

    valid: Rate
    collisions: Rate
    at_fault: Rate


@dataclass(frozen=True)
class Matrix:
    """Targets down, backgrounds across.

    Attributes:
        targets: labels of the rows.
        backgrounds: labels of the columns.
        cells: rows of cells; None where that pair was not run.
    """

    targets: tuple[str, ...]
    backgrounds: tuple[str, ...]
    cells: tuple[tuple[MatrixCell | None, ...], ...]

    @property
    def is_single(self) -> bool:
        """Whether there is but one cell, which the headline tells already."""
        return len(self.targets) * len(self.backgrounds) <= 1


def matrix_of(rows: Sequence[Row], labels: Labels) -> Matrix:
    """Return the matrix of *rows* of ``episodes.parquet``, in the order of their first episodes."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((labels.target(row), labels.background(row)), []).append(row)
    targets = tuple(dict.fromkeys(target for target, _ in groups))
    backgrounds = tuple(dict.fromkeys(background for _, background in groups))
    cells = tuple(tuple(_cell(groups.get((t, b))) for b in backgrounds) for t in targets)
    return Matrix(targets, backgrounds, cells)


def _cell(rows: Sequence[Row] | None) -> MatrixCell | None:
    if not rows:
        return None
    finished = [row for row in rows if row["end"] != "failed"]
    hit = [bool(row["target_collision"]) for row in finished]
    guilty = [row["at_fault"] == "target" for row in finished]
    counted = [is_valid_failure(row) for row in finished if row["valid_failure"] is not None]
    return MatrixCell(
        valid=Rate.of_flags(counted),
        collisions=Rate.of_flags(hit),
        at_fault=Rate.of_flags(guilty),
    )
