"""The archive of a sweep: episodes by kind of attack, approach of the attacker, and manoeuvre of the target.

Quality diversity (Mouret and Clune 2015, arXiv:1504.04909) keeps the best solution of every cell. Here that is the most
severe episode, and a valid failure fills a cell.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from advdiff_sumo.metrics.severity import is_failure, is_valid_failure, worst_first

Row: TypeAlias = Mapping[str, Any]

APPROACHES = ("ahead", "behind", "beside_left", "beside_right", "oncoming", "from_left", "from_right")
"""From where the other came: on the target's lane, beside it, oncoming, or across its way."""
ANY = "any"
"""Kind of attack requested if any kind will do."""
NATURAL = "natural"
"""Kind of an encounter with a road user that did not attack."""
MANOEUVRES = ("straight", "turn_left", "turn_right", "standing")
"""Manoeuvres of the target up to the critical instant."""


class ArchiveCell(NamedTuple):
    """One kind of encounter.

    Attributes:
        kind: kind of attack of the other, or ``NATURAL``; the kind requested if the background does not report it.
        approach: one of ``APPROACHES``.
        manoeuvre: manoeuvre of the target, one of ``MANOEUVRES``.
    """

    kind: str
    approach: str
    manoeuvre: str


@dataclass(frozen=True)
class Elite:
    """The content of a cell.

    Attributes:
        episodes: number of its episodes.
        valid: number of valid failures among them.
        worst: row of the most severe of them.
    """

    episodes: int
    valid: int
    worst: Row


def cell_of(row: Row) -> ArchiveCell | None:
    """Return the cell of an episode; None if it failed, no vehicle could attack, or none was near.

    Args:
        row: row of a sweep's ``episodes``.
    """
    if is_failure(row) or row["in_position"] is False or not row.get("approach"):
        return None
    kind = row.get("attacker_manoeuvre") or row["attack"]
    return ArchiveCell(str(kind), str(row["approach"]), str(row["target_manoeuvre"]))


def archive(rows: Iterable[Row]) -> dict[ArchiveCell, Elite]:
    """Return the cells that have an episode, in alphabetical order.

    Args:
        rows: rows of a sweep's ``episodes``, of one target or several.
    """
    members: dict[ArchiveCell, list[Row]] = {}
    for row in rows:
        cell = cell_of(row)
        if cell is not None:
            members.setdefault(cell, []).append(row)
    return {
        cell: Elite(len(episodes), sum(map(is_valid_failure, episodes)), worst_first(episodes)[0])
        for cell, episodes in sorted(members.items())
    }
