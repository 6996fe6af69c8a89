"""Headline rates of a run with their confidence intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from advdiff_sumo.metrics.severity import broke_rule, has_outcome, is_failure, is_valid_failure
from advdiff_sumo.metrics.statistics import Rate


@dataclass(frozen=True)
class HeadlineRate:
    """A rate with its words.

    Attributes:
        label: what happened.
        of: what is counted.
        rate: how often.
    """

    label: str
    of: str
    rate: Rate


def headline(episodes: Sequence[Mapping[str, Any]], unstarted: int = 0) -> tuple[HeadlineRate, ...]:
    """Return the rates that a report begins with.

    Failed episodes count in the rate of failures alone, as what would have happened in them is not known, unless the
    target had collided before. Whether the target saw the other party is known of targets that SUMO drives; without
    any the line is left out.

    Args:
        episodes: rows of ``episodes.parquet``.
        unstarted: how many more failed before they had a row.
    """
    counted = [row for row in episodes if has_outcome(row)]
    of = "episodes with an outcome" if any(map(is_failure, counted)) else "finished episodes"
    struck = [row for row in counted if row["target_collision"]]
    seen = [bool(row["attacker_visible"]) for row in struck if row["attacker_visible"] is not None]
    judged = [row for row in counted if row["valid_failure"] is not None]
    critical = [row for row in counted if row["critical"] is not None]
    looked_at = [row for row in counted if row["offences"] is not None]
    return (
        _line("Valid failures", "judged episodes", [is_valid_failure(r) for r in judged]),
        _line("Critical near misses", "judged episodes", [bool(r["critical"]) for r in critical]),
        _line("Rules broken by the target", "judged episodes", [broke_rule(r) for r in looked_at]),
        _line("Collisions", of, [bool(r["target_collision"]) for r in counted]),
        _line("Collisions, target at fault", of, [r["at_fault"] == "target" for r in counted]),
        *([_line("Target saw the other", "collisions of SUMO's drivers", seen)] if seen else []),
        _line("Route completed", of, [bool(r["route_completed"]) for r in counted]),
        _line("Failed episodes", "episodes", [*map(is_failure, episodes), *([True] * unstarted)]),
    )


def _line(label: str, of: str, flags: Sequence[bool]) -> HeadlineRate:
    return HeadlineRate(label, of, Rate.of_flags(flags))
