"""Cluster near-duplicate collisions: a thousand collisions become a dozen findings, the most important first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.metrics.severity import is_valid_failure, worst_first

Row: TypeAlias = Mapping[str, Any]

#: Tolerances: two collisions of one finding never differ by more.
IMPACT_M = 3.0
APPROACH_M = 10.0
SPEED_MPS = 6.0
HEADING_RAD = 0.7853981633974483  # 45°
_FIRST_GRID = 0.25  # share of a tolerance within which collisions count as one point, if there are too many
_MAX_POINTS = 5000


@dataclass(frozen=True)
class Finding:
    """Collisions of one type with similar geometry.

    Attributes:
        type: type of collision.
        junction_type: SUMO's type of junction, or road.
        episodes: numbers of the episodes, the worst first.
        worst: row of the worst episode, which represents the finding.
        valid: number of valid failures.
        at_fault: number of collisions by party at fault.
        targets: number of collisions by target and its options as JSON.
    """

    type: str
    junction_type: str
    episodes: tuple[int, ...]
    worst: Row
    valid: int
    at_fault: Mapping[str, int]
    targets: Mapping[tuple[str, str], int]


def findings(episodes: Sequence[Row]) -> list[Finding]:
    """Cluster the target's collisions by type, type of junction and geometry; the one with most valid failures first.

    Complete linkage under the Chebyshev distance of impact point, approach and speeds, each divided by its tolerance.
    Within a finding no two collisions differ by more than the tolerances.

    Args:
        episodes: rows of a sweep's ``episodes``.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in worst_first(row for row in episodes if row["target_collision"]):
        groups.setdefault((str(row["collision_type"]), str(row["junction_type"])), []).append(row)
    clusters = [_finding(kind, members) for kind in sorted(groups) for members in _clusters(groups[kind])]
    return sorted(
        clusters, key=lambda f: (-f.valid, -len(f.episodes), f.type, f.junction_type, f.episodes[0])
    )


def _finding(kind: tuple[str, str], members: list[Row]) -> Finding:
    """Return the finding of *members*, which are sorted from worst to least."""
    return Finding(
        *kind,
        episodes=tuple(int(row["episode"]) for row in members),
        worst=members[0],
        valid=sum(map(is_valid_failure, members)),
        at_fault=dict(sorted(Counter(str(row["at_fault"]) for row in members).items())),
        targets=dict(
            sorted(Counter((str(row["target"]), str(row["target_options"])) for row in members).items())
        ),
    )


def _clusters(rows: list[Row]) -> Iterator[list[Row]]:
    """Yield the clusters of *rows*; each keeps their order."""
    features = np.array([_features(row) for row in rows])
    points, point_of_row = _points(features)
    labels = np.ones(len(points), dtype=np.int64)
    if len(points) > 1:
        tree = linkage(points, method="complete", metric="chebyshev")
        labels = fcluster(tree, t=1.0, criterion="distance").astype(np.int64)
    row_labels = labels[point_of_row]
    for label in sorted(set(row_labels.tolist()), key=row_labels.tolist().index):
        yield [row for row, row_label in zip(rows, row_labels, strict=True) if row_label == label]


def _points(features: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return distinct points and the index of each row's point; on a grid if there are too many points."""
    points, point_of_row = np.unique(features, axis=0, return_inverse=True)
    grid = _FIRST_GRID
    while len(points) > _MAX_POINTS:
        points, point_of_row = np.unique(np.round(features / grid) * grid, axis=0, return_inverse=True)
        grid *= 2.0
    return points, point_of_row.reshape(-1).astype(np.int64)


def _features(row: Row) -> list[float]:
    """Return the geometry of a collision divided by the tolerances; undefined values count as 0."""
    yaw = row["approach_yaw_rad"]
    chord = 2.0 * np.sin(HEADING_RAD / 2.0)
    heading = (0.0, 0.0) if yaw is None else (np.cos(yaw) / chord, np.sin(yaw) / chord)
    units = {
        "impact_ahead_m": IMPACT_M,
        "impact_left_m": IMPACT_M,
        "approach_ahead_m": APPROACH_M,
        "approach_left_m": APPROACH_M,
        "target_speed_mps": SPEED_MPS,
        "partner_speed_mps": SPEED_MPS,
    }
    return [*(float(row[name] or 0.0) / unit for name, unit in units.items()), *map(float, heading)]
