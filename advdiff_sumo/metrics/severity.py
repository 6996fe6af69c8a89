"""Order episodes by severity, for reports, findings and lists."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

Row: TypeAlias = Mapping[str, Any]

_FAULT_ORDER = {"target": 0, "unclear": 1, "other": 2}


def is_failure(row: Row) -> bool:
    """Return whether the episode could not be finished."""
    return bool(row["end"] == "failed")


def has_outcome(row: Row) -> bool:
    """Return whether rates include the episode: it was finished, or failed only after the target's collision."""
    return not is_failure(row) or bool(row.get("target_collision"))


def is_valid_failure(row: Row) -> bool:
    """Return whether the episode ended in a valid failure; False if it has no verdict yet."""
    return bool(row["target_collision"]) and bool(row.get("valid_failure"))


def broke_rule(row: Row) -> bool:
    """Return whether the target broke a rule, with or without a collision; False if unknown."""
    return bool(row.get("offences"))


def badge(row: Row) -> str:
    """Return the verdict of an episode in one or two words."""
    if row.get("target_collision"):  # also if the episode failed after it
        if row.get("valid_failure") is None:
            return "not judged"
        if row["valid_failure"]:
            return "valid failure"
        return "unavoidable" if row.get("unavoidable") else "not counted"
    if is_failure(row):
        return "failed"
    if row.get("critical"):
        return "critical"
    return "rule broken" if broke_rule(row) else "no collision"


def worst_first(rows: Iterable[Row]) -> list[Row]:
    """Return the episodes by severity, the worst first.

    1. Collisions: valid failures first, then by fault (target, unclear, other), then by closing speed.
    2. Episodes that could not be finished.
    3. Critical near misses, by the braking that they needed.
    4. Episodes in which the target broke a rule, by time to collision, then by clearance.
    5. All others, in the same order.

    Args:
        rows: rows of ``episodes.parquet``.
    """
    return sorted(rows, key=severity)


def severity(row: Row) -> tuple[float, ...]:
    """Return the sort key of :func:`worst_first`."""
    number = float(row["episode"])
    if row["target_collision"]:
        validity = 0.0 if is_valid_failure(row) else 1.0
        return (
            0.0,
            validity,
            _FAULT_ORDER.get(row["at_fault"], 3),
            -_known(row["closing_speed_mps"], 0.0),
            number,
        )
    if is_failure(row):
        return 1.0, number
    if row.get("critical"):
        return 2.0, -_known(row["critical_brake_mps2"], 0.0), number
    tier = 3.0 if broke_rule(row) else 4.0
    return tier, _known(row["min_ttc_s"]), _known(row["min_clearance_m"]), number


def _known(value: float | None, default: float = math.inf) -> float:
    return default if value is None or math.isnan(value) else value
