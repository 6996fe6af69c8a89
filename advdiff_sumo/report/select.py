"""Which episodes get a picture, and who of the others matters in them."""

from __future__ import annotations

from collections.abc import Iterable

from advdiff_sumo.metrics.severity import Row, is_failure

#: Episodes with neither collision nor failure that get a picture.
UNEVENTFUL_SHOWN = 20


def is_eventful(row: Row) -> bool:
    """Return whether the episode ended in a collision of the target or a failure."""
    return bool(row["target_collision"]) or is_failure(row)


def pictured(ordered: Iterable[Row]) -> list[Row]:
    """Return the episodes that get a picture: all eventful ones and the worst of the others, order kept."""
    chosen, uneventful = [], 0
    for row in ordered:
        uneventful += not is_eventful(row)
        if is_eventful(row) or uneventful <= UNEVENTFUL_SHOWN:
            chosen.append(row)
    return chosen


def attacker_of(row: Row) -> str | None:
    """Return the target's collision partner, or else who came nearest to it in time or space; None when nobody did."""
    for column in ("collision_partner", "min_ttc_partner", "min_clearance_partner"):
        if row[column]:
            return str(row[column])
    return None
