"""Selects the episodes that get a picture, and the vehicle shown as attacker in each."""

from __future__ import annotations

from collections.abc import Iterable

from advdiff_sumo.metrics.severity import Row, is_failure

#: Number of episodes with neither collision nor failure that get a picture.
UNEVENTFUL_SHOWN = 20


def is_eventful(row: Row) -> bool:
    """Return whether the episode ended in a collision of the target or a failure."""
    return bool(row["target_collision"]) or is_failure(row)


def pictured_episodes(ordered: Iterable[Row]) -> list[Row]:
    """Return the episodes that get a picture, in order: all eventful ones, and the first of the others."""
    selected, uneventful = [], 0
    for row in ordered:
        uneventful += not is_eventful(row)
        if is_eventful(row) or uneventful <= UNEVENTFUL_SHOWN:
            selected.append(row)
    return selected


def attacker_of(row: Row) -> str | None:
    """Return the partner of the target's collision or critical near miss, else who came nearest in time or space."""
    for column in ("collision_partner", "near_miss_partner", "min_ttc_partner", "min_clearance_partner"):
        if row.get(column):
            return str(row[column])
    return None


def nearest_s(row: Row) -> float | None:
    """Return the time of the critical near miss, else of the least clearance; None if nobody came near."""
    near_miss_s: float | None = row.get("near_miss_time_s")
    return row["min_clearance_time_s"] if near_miss_s is None else near_miss_s
