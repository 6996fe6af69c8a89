"""Headline rates of a run with their confidence intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.stats import binomtest

from advdiff_sumo.metrics.severity import is_valid_failure

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Rate:
    """How often something happened.

    Attributes:
        label: what.
        of: what is counted in *n*.
        count: how often, 0 to *n*.
        n: sample size.
        low: lower end of the 95 % interval; None without a sample.
        high: upper end; None without a sample.
    """

    label: str
    of: str
    count: int
    n: int
    low: float | None
    high: float | None

    @staticmethod
    def of_flags(label: str, of: str, flags: Sequence[bool]) -> Rate:
        """Return the share of *flags* that are set."""
        count = sum(flags)
        return Rate(label, of, count, len(flags), *wilson(count, len(flags)))

    @property
    def share(self) -> float | None:
        """The observed share; None without a sample."""
        return self.count / self.n if self.n else None


def wilson(count: int, n: int) -> tuple[float, float] | tuple[None, None]:
    """Return the 95 % score interval of a share (Wilson 1927, doi:10.1080/01621459.1927.10502953).

    (None, None) without a sample.
    """
    if n == 0:
        return None, None
    interval = binomtest(count, n).proportion_ci(CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)


def headline(episodes: Sequence[Mapping[str, Any]]) -> tuple[Rate, ...]:
    """Return the rates that a report begins with.

    Failed episodes count in the rate of failures alone: what would have happened in them is not known.

    Args:
        episodes: rows of ``episodes.parquet``.
    """
    finished = [row for row in episodes if row["end"] != "failed"]
    struck = [row for row in finished if row["target_collision"]]
    judged_visible = [row for row in struck if row["attacker_visible"] is not None]
    judged = [row for row in finished if row["valid_failure"] is not None]
    critical = [row for row in finished if row["critical"] is not None]
    return (
        Rate.of_flags("Valid failures", "judged episodes", [is_valid_failure(r) for r in judged]),
        Rate.of_flags("Critical near misses", "judged episodes", [bool(r["critical"]) for r in critical]),
        Rate.of_flags("Collisions", "finished episodes", [bool(r["target_collision"]) for r in finished]),
        Rate.of_flags(
            "Collisions, target at fault", "finished episodes", [r["at_fault"] == "target" for r in finished]
        ),
        Rate.of_flags(
            "Attacker was visible",
            "collisions where that is known",
            [bool(r["attacker_visible"]) for r in judged_visible],
        ),
        Rate.of_flags("Route completed", "finished episodes", [bool(r["route_completed"]) for r in finished]),
        Rate.of_flags("Failures", "episodes", [r["end"] == "failed" for r in episodes]),
    )
