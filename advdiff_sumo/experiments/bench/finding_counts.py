"""What the findings of ``bench defects`` are worth: how many are valid and lawful, how diverse, and at what cost."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from advdiff_sumo.experiments.bench.detection import Tried, first_detection
from advdiff_sumo.experiments.bench.episode_results import Gathered
from advdiff_sumo.experiments.bench.formatting import comma_separated
from advdiff_sumo.metrics.archive import archive
from advdiff_sumo.metrics.severity import is_valid_failure

DRAWN = 100
"""Episodes that :attr:`FindingCounts.cells_per_100` stands for."""


@dataclass(frozen=True)
class FindingCounts:
    """All episodes of one target, sound and with each defect, before one background.

    Attributes:
        episodes: finished.
        collisions: of the target.
        valid: collisions that are valid failures.
        others_broke: collisions before which the other party broke a rule.
        breaches: how often which rule; one collision may count for several.
        cells: cells of the archive that hold a valid failure.
        cells_per_100: expected number of these among 100 of the episodes, drawn without replacement; None for fewer.
    """

    episodes: int
    collisions: int
    valid: int
    others_broke: int
    breaches: Mapping[str, int]
    cells: int
    cells_per_100: float | None


def count_findings(rows: Sequence[Mapping[str, Any]]) -> FindingCounts:
    """Return what *rows* of ``episodes`` come to."""
    hits = [row for row in rows if row["target_collision"]]
    broken = [row["other_breaches"].split(", ") for row in hits if row.get("other_breaches")]
    filled = [elite.valid for elite in archive(rows).values() if elite.valid]
    return FindingCounts(
        episodes=len(rows),
        collisions=len(hits),
        valid=sum(map(is_valid_failure, hits)),
        others_broke=len(broken),
        breaches=dict(sorted(Counter(kind for kinds in broken for kind in kinds).items())),
        cells=len(filled),
        cells_per_100=rarefied(filled, len(rows), DRAWN),
    )


def rarefied(members: Iterable[int], total: int, drawn: int) -> float | None:
    """Return how many groups are expected among *drawn* of *total* members (Hurlbert 1971, doi:10.2307/1934145).

    Args:
        members: of each group; others belong to none.
        total: of all.
        drawn: without replacement; None is returned where there are fewer.
    """
    if drawn > total:
        return None
    ways = math.comb(total, drawn)
    return sum(1.0 - math.comb(total - count, drawn) / ways for count in members)


def first_costs(sound: Tried, defective: Mapping[str, Tried]) -> list[float]:
    """Return the processor time until each defect alone is detected, s; infinite for those that never are."""
    firsts = [first_detection(sound, {name: tried}) for name, tried in defective.items()]
    return [math.inf if first is None else first.cpu_s for first in firsts]


def findings_text(
    gathered: Gathered,
    costs: Mapping[tuple[str, str], Sequence[float]],
    ranked: Mapping[tuple[str, str], float | None],
) -> str:
    """Return one line a target and background.

    Args:
        gathered: the episodes.
        costs: of :func:`first_costs`, by background and target; they differ between machines.
        ranked: how well valid failures tell defective from sound planners (AUC), by background and target.
    """
    rows: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for cell, episodes in gathered.finished.items():
        asked = cell.background_options.get("attack", cell.background)  # as in a sweep's table
        rows.setdefault((cell.row, cell.target), []).extend({**one.row, "attack": asked} for one in episodes)
    counts = ("episodes", "collisions", "valid", "others_broke")
    names = (
        "background",
        "target",
        *counts,
        "breaches",
        "cells",
        "cells_per_100",
        "median_first_cpu_s",
        "auc",
    )
    lines: list[tuple[object, ...]] = []
    for key, some in rows.items():
        worth = count_findings(some)
        breaches = " ".join(f"{kind}:{count}" for kind, count in worth.breaches.items())
        numbers = (getattr(worth, name) for name in counts)
        cost = _figure(_median(costs.get(key, ())), 1)
        shares = (_figure(worth.cells_per_100, 2), cost, _figure(ranked.get(key), 3))
        lines.append((*key, *numbers, breaches, worth.cells, *shares))
    return comma_separated(names, lines)


def _median(costs: Sequence[float]) -> float | None:
    """Return the median, or None where half of the defects are never detected."""
    middle = median(costs) if costs else math.inf
    return middle if math.isfinite(middle) else None


def _figure(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
