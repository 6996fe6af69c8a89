"""The archive of a sweep on the page: which encounters came about, and in which of them each target failed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from advdiff_sumo.metrics.archive import MANOEUVRES, ArchiveCell, Elite, archive
from advdiff_sumo.report.folder import Row
from advdiff_sumo.report.labels import Labels


@dataclass(frozen=True)
class ArchiveLine:
    """One line of the table.

    Attributes:
        kind: of the attack.
        approach: from where the other came.
        elites: what is in the cells, in the order of ``MANOEUVRES``; None for an empty one.
    """

    kind: str
    approach: str
    elites: tuple[Elite | None, ...]


@dataclass(frozen=True)
class ArchiveTable:
    """The archive of one target.

    Attributes:
        target: its label.
        filled: cells with a valid failure.
        met: cells with an episode.
        lines: of the table.
    """

    target: str
    filled: int
    met: int
    lines: tuple[ArchiveLine, ...]


def archives_of(rows: Sequence[Row], labels: Labels) -> list[ArchiveTable]:
    """Return the archive of every target that a background attacked; none for the folder of a run.

    Args:
        rows: of ``episodes.parquet``.
        labels: names of the targets.
    """
    by_target: dict[str, list[Row]] = {}
    for row in rows:
        if row["attack_kind"] is not None:
            by_target.setdefault(labels.target(row), []).append(row)
    tables = [_table(target, archive(some)) for target, some in by_target.items()]
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
