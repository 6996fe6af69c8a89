"""Compute the rates of a sweep with their intervals, for its summary and for conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, TypeAlias

from advdiff_sumo.metrics.severity import broke_rule, has_outcome, is_failure, is_valid_failure
from advdiff_sumo.metrics.statistics import Rate

Row: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True)
class Event:
    """An event that may occur in an episode.

    Attributes:
        label: name in reports.
        happened: returns whether it occurred, from a row of ``episodes``.
        known_by: column that must be present to know: folders of earlier versions have no verdicts.
    """

    label: str
    happened: Callable[[Row], bool]
    known_by: str


EVENTS: Mapping[str, Event] = {
    "valid_failure_rate": Event("valid failures", is_valid_failure, "valid_failure"),
    "critical_rate": Event("critical near misses", lambda row: bool(row.get("critical")), "critical"),
    "offence_rate": Event("rules broken by the target", broke_rule, "offences"),
    "collision_rate": Event("collisions", lambda row: bool(row["target_collision"]), "target_collision"),
    "fault_rate": Event("… target at fault", lambda row: row["at_fault"] == "target", "target_collision"),
    "completion_rate": Event("route completed", lambda row: bool(row["route_completed"]), "route_completed"),
}
"""Events by the name of their rate."""
_MEDIANS = ("min_ttc_s", "min_pet_s", "min_clearance_m", "max_drac_mps2", "brake_max_mps2", "jerk_max_mps3")
#: Every name that a condition may use.
FIGURE_NAMES = frozenset(
    {"episodes", "finished", "valid_failures", "collisions", "failures", "missing"}
    | {f"{rate}{end}" for rate in (*EVENTS, "failure_rate") for end in ("", "_low", "_high")}
    | {f"median_{column}" for column in _MEDIANS}
)


@dataclass(frozen=True)
class Figures:
    """Results of a sweep or a part of it.

    Attributes:
        episodes: number of episodes with a row, finished or not, and of those that failed without one.
        rates: rates by name. That of failures is out of all episodes. The others are out of those with an outcome
            (and a verdict): finished, or failed after a collision of the target.
        medians: medians over the episodes with an outcome in which the value is defined.
        missing: number of episodes that have not been run.
    """

    episodes: int
    rates: Mapping[str, Rate]
    medians: Mapping[str, float | None]
    missing: int = 0

    @staticmethod
    def of(episodes: Sequence[Row], failures: Sequence[Row], missing: int = 0) -> Figures:
        """Return the figures of *episodes* and *failures*, rows of the tables of these names."""
        total = sum(not is_failure(row) for row in episodes) + len(failures)
        counted = [row for row in episodes if has_outcome(row)]
        rates = {name: _rate(counted, event) for name, event in EVENTS.items()}
        rates["failure_rate"] = Rate.of(len(failures), total)
        values = {column: [row[column] for row in counted if row[column] is not None] for column in _MEDIANS}
        medians = {name: float(median(defined)) if defined else None for name, defined in values.items()}
        return Figures(total, rates, medians, missing)

    def named(self) -> dict[str, float | None]:
        """Return every figure of ``FIGURE_NAMES``."""
        collisions, failures = self.rates["collision_rate"], self.rates["failure_rate"]
        named: dict[str, float | None] = {
            "episodes": self.episodes,
            "finished": self.episodes - failures.count,
            "valid_failures": self.rates["valid_failure_rate"].count,
            "collisions": collisions.count,
            "failures": failures.count,
            "missing": self.missing,
        }
        for name, rate in self.rates.items():
            named |= {name: rate.share, f"{name}_low": rate.low, f"{name}_high": rate.high}
        return named | {f"median_{name}": value for name, value in self.medians.items()}


def _rate(rows: Sequence[Row], event: Event) -> Rate:
    """Return the rate of *event* among the rows in which it is known."""
    known = [row for row in rows if row.get(event.known_by) is not None]
    return Rate.of(sum(map(event.happened, known)), len(known))


def by_kind(
    episodes: Sequence[Row], failures: Sequence[Row], columns: Sequence[str]
) -> dict[tuple[str, ...], Figures]:
    """Return the figures for each combination of values of *columns*, in order of first appearance."""
    kinds: dict[tuple[str, ...], tuple[list[Row], list[Row]]] = {}
    for table_index, rows in enumerate((episodes, failures)):
        for row in rows:
            key = tuple(str(row[column]) for column in columns)
            kinds.setdefault(key, ([], []))[table_index].append(row)
    return {key: Figures.of(*rows) for key, rows in kinds.items()}
