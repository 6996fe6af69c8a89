"""Which episodes come first, which get a picture, and who of the others matters in them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

Row: TypeAlias = Mapping[str, Any]

#: Episodes with neither collision nor failure that get a picture.
UNEVENTFUL_SHOWN = 20
_FAULT_ORDER = {"target": 0, "unclear": 1, "other": 2}


def is_failure(row: Row) -> bool:
    """Return whether the episode could not be finished."""
    return bool(row["end"] == "failed")


def is_eventful(row: Row) -> bool:
    """Return whether the episode ended in a collision of the target or a failure."""
    return bool(row["target_collision"]) or is_failure(row)


def worst_first(rows: Iterable[Row]) -> list[Row]:
    """Return the episodes by severity.

    Collisions (those the target caused first, then by relative speed), failures, then the others from the
    least time to collision to the largest, then by clearance.
    """
    return sorted(rows, key=_severity)


def pictured(ordered: Iterable[Row]) -> list[Row]:
    """Return the episodes that get a picture: all eventful ones and the worst of the others, order kept."""
    chosen, uneventful = [], 0
    for row in ordered:
        uneventful += not is_eventful(row)
        if is_eventful(row) or uneventful <= UNEVENTFUL_SHOWN:
            chosen.append(row)
    return chosen


def attacker_of(row: Row) -> str | None:
    """Return who hit the target, or else who came nearest to it in time or space; None when nobody did."""
    for column in ("collision_partner", "min_ttc_partner", "min_clearance_partner"):
        if row[column]:
            return str(row[column])
    return None


def _severity(row: Row) -> tuple[float, ...]:
    number = float(row["episode"])
    if row["target_collision"]:
        return 0.0, _FAULT_ORDER.get(row["at_fault"], 3), -_known(row["relative_speed_mps"], 0.0), number
    if is_failure(row):
        return 1.0, number
    return 2.0, _known(row["min_ttc_s"]), _known(row["min_clearance_m"]), number


def _known(value: float | None, otherwise: float = math.inf) -> float:
    return otherwise if value is None or math.isnan(value) else value
