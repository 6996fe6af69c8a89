"""Counts the findings of ``bench defects``: how many are valid and lawful, how diverse they are, and their cost."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from advdiff_sumo.experiments.bench.detection import SceneOutcomes, first_detection
from advdiff_sumo.experiments.bench.episode_results import Gathered
from advdiff_sumo.experiments.bench.formatting import comma_separated
from advdiff_sumo.metrics.archive import archive
from advdiff_sumo.metrics.severity import is_valid_failure

SAMPLE_SIZE = 100
"""Number of episodes for :attr:`FindingCounts.cells_per_100`."""


@dataclass(frozen=True)
class FindingCounts:
    """Counts over all episodes of one target, sound and with each defect, with one background.

    Attributes:
        episodes: finished episodes.
        collisions: of the target.
        valid: collisions that are valid failures.
        others_broke: collisions before which the other party broke a rule.
        breaches: rule → number of collisions before which the other party broke it.
        cells: cells of the archive that hold a valid failure.
        cells_per_100: expected number of these cells in 100 of the episodes, drawn without replacement; None if there
            are fewer episodes.
    """

    episodes: int
    collisions: int
    valid: int
    others_broke: int
    breaches: Mapping[str, int]
    cells: int
    cells_per_100: float | None


def count_findings(rows: Sequence[Mapping[str, Any]]) -> FindingCounts:
    """Return the counts of *rows* of ``episodes``."""
    collisions = [row for row in rows if row["target_collision"]]
    breaches = [row["other_breaches"].split(", ") for row in collisions if row.get("other_breaches")]
    valid_per_cell = [elite.valid for elite in archive(rows).values() if elite.valid]
    return FindingCounts(
        episodes=len(rows),
        collisions=len(collisions),
        valid=sum(map(is_valid_failure, collisions)),
        others_broke=len(breaches),
        breaches=dict(sorted(Counter(kind for kinds in breaches for kind in kinds).items())),
        cells=len(valid_per_cell),
        cells_per_100=expected_groups(valid_per_cell, len(rows), SAMPLE_SIZE),
    )


def expected_groups(members: Iterable[int], total: int, drawn: int) -> float | None:
    """Return the expected number of groups in a sample of *drawn* members (Hurlbert 1971, doi:10.2307/1934145).

    Args:
        members: number of members of each group; the remaining ones belong to no group.
        total: number of all members.
        drawn: size of the sample, without replacement. None is returned if it exceeds *total*.
    """
    if drawn > total:
        return None
    samples = math.comb(total, drawn)
    return sum(1.0 - math.comb(total - count, drawn) / samples for count in members)


def first_costs(sound: SceneOutcomes, defective: Mapping[str, SceneOutcomes]) -> list[float]:
    """Return the processor time (s) until each defect is detected if tested alone; infinite if it never is."""
    firsts = [first_detection(sound, {name: outcomes}) for name, outcomes in defective.items()]
    return [math.inf if first is None else first.cpu_s for first in firsts]


def findings_text(
    gathered: Gathered,
    costs: Mapping[tuple[str, str], Sequence[float]],
    aucs: Mapping[tuple[str, str], float | None],
) -> str:
    """Return a CSV line for each target and background.

    Args:
        gathered: the episodes.
        costs: of :func:`first_costs`, by background and target; they differ between machines.
        aucs: how well valid failures separate defective from sound planners, by background and target.
    """
    rows: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for cell, episodes in gathered.finished.items():
        attack = cell.background_options.get("attack", cell.background)  # as in a sweep's table
        rows.setdefault((cell.row, cell.target), []).extend(
            {**result.row, "attack": attack} for result in episodes
        )
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
    for key, episode_rows in rows.items():
        findings = count_findings(episode_rows)
        breaches = " ".join(f"{kind}:{count}" for kind, count in findings.breaches.items())
        numbers = (getattr(findings, name) for name in counts)
        cost = _formatted(_median(costs.get(key, ())), 1)
        figures = (_formatted(findings.cells_per_100, 2), cost, _formatted(aucs.get(key), 3))
        lines.append((*key, *numbers, breaches, findings.cells, *figures))
    return comma_separated(names, lines)


def _median(costs: Sequence[float]) -> float | None:
    """Return the median; None if it is infinite, as many defects are never detected."""
    middle = median(costs) if costs else math.inf
    return middle if math.isfinite(middle) else None


def _formatted(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
