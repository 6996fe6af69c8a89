"""The archive of a sweep: which kinds of attack met which target from where, and in which manoeuvre of its own.

Quality diversity (Mouret and Clune 2015, arXiv:1504.04909) keeps the best of every cell; here that is the worst
episode, and a cell is filled by a valid failure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from advdiff_sumo.metrics.severity import is_failure, is_valid_failure, worst_first

Row: TypeAlias = Mapping[str, Any]

APPROACHES = ("ahead", "behind", "beside_left", "beside_right", "oncoming", "from_left", "from_right")
"""From where the other came: on the target's lane, beside it, against it, or across its way."""
ANY = "any"
"""Kind that is asked for where all are welcome."""
NATURAL = "natural"
"""Kind of an encounter with somebody who did nothing against the target."""
MANOEUVRES = ("straight", "turn_left", "turn_right", "standing")
"""What the target did up to the critical moment."""


class ArchiveCell(NamedTuple):
    """One kind of encounter.

    Attributes:
        kind: of the attack that the other drove, or ``NATURAL``; what was asked for where the background does not tell.
        approach: one of ``APPROACHES``.
        manoeuvre: of the target, one of ``MANOEUVRES``.
    """

    kind: str
    approach: str
    manoeuvre: str


@dataclass(frozen=True)
class Elite:
    """What is in a cell.

    Attributes:
        episodes: how many met like this.
        valid: how many of them are valid failures.
        worst: row of the worst of them.
    """

    episodes: int
    valid: int
    worst: Row


def cell_of(row: Row) -> ArchiveCell | None:
    """Return the cell of an episode; None where it failed, nobody could attack, or nobody was near.

    Args:
        row: of a sweep's ``episodes``.
    """
    if is_failure(row) or row["in_position"] is False or not row.get("approach"):
        return None
    kind = row.get("attacker_manoeuvre") or row["attack"]
    return ArchiveCell(str(kind), str(row["approach"]), str(row["target_manoeuvre"]))


def archive(rows: Iterable[Row]) -> dict[ArchiveCell, Elite]:
    """Return the cells that have an episode, in alphabetical order.

    Args:
        rows: of a sweep's ``episodes``; of one target, or of several together.
    """
    members: dict[ArchiveCell, list[Row]] = {}
    for row in rows:
        cell = cell_of(row)
        if cell is not None:
            members.setdefault(cell, []).append(row)
    return {
        cell: Elite(len(some), sum(map(is_valid_failure, some)), worst_first(some)[0])
        for cell, some in sorted(members.items())
    }
