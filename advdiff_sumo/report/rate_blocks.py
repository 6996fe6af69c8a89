"""Computes the headline rates of a run with their confidence intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from advdiff_sumo.metrics.severity import broke_rule, has_outcome, is_failure, is_valid_failure
from advdiff_sumo.metrics.statistics import Rate


@dataclass(frozen=True)
class HeadlineRate:
    """A rate with its description.

    Attributes:
        label: event that is counted.
        of: name of all trials.
        rate: of the event among the trials.
    """

    label: str
    of: str
    rate: Rate


def headline(episodes: Sequence[Mapping[str, Any]], unstarted: int = 0) -> tuple[HeadlineRate, ...]:
    """Return the rates at the top of a report.

    Failed episodes count only in the rate of failed episodes, as their outcomes are unknown, unless the target had
    collided before. Whether the target saw the other party is known only of SUMO's drivers; otherwise this line is left
    out.

    Args:
        episodes: rows of ``episodes.parquet``.
        unstarted: number of further episodes that failed before they had a row.
    """
    with_outcome = [row for row in episodes if has_outcome(row)]
    trials = "episodes with an outcome" if any(map(is_failure, with_outcome)) else "finished episodes"
    collided = [row for row in with_outcome if row["target_collision"]]
    was_seen = [bool(row["attacker_visible"]) for row in collided if row["attacker_visible"] is not None]
    with_verdict = [row for row in with_outcome if row["valid_failure"] is not None]
    with_critical = [row for row in with_outcome if row["critical"] is not None]
    with_offences = [row for row in with_outcome if row["offences"] is not None]
    return (
        _line("Valid failures", "judged episodes", [is_valid_failure(r) for r in with_verdict]),
        _line("Critical near misses", "judged episodes", [bool(r["critical"]) for r in with_critical]),
        _line("Rules broken by the target", "judged episodes", [broke_rule(r) for r in with_offences]),
        _line("Collisions", trials, [bool(r["target_collision"]) for r in with_outcome]),
        _line("Collisions, target at fault", trials, [r["at_fault"] == "target" for r in with_outcome]),
        *([_line("Target saw the other", "collisions of SUMO's drivers", was_seen)] if was_seen else []),
        _line("Route completed", trials, [bool(r["route_completed"]) for r in with_outcome]),
        _line("Failed episodes", "episodes", [*map(is_failure, episodes), *([True] * unstarted)]),
    )


def _line(label: str, of: str, flags: Sequence[bool]) -> HeadlineRate:
    return HeadlineRate(label, of, Rate.of_flags(flags))
