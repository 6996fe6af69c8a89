"""Near-duplicates among collisions: a thousand hits become a dozen findings, those that count first."""

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

#: Two collisions of one finding never differ by more than these.
IMPACT_M = 3.0
APPROACH_M = 10.0
SPEED_MPS = 6.0
HEADING_RAD = 0.7853981633974483  # 45°
_COARSE = 0.25  # of a tolerance: collisions that agree so far are one point
_MOST_POINTS = 5000


@dataclass(frozen=True)
class Finding:
    """Collisions of one type that look alike.

    Attributes:
        type: kind of collision.
        junction_type: where: SUMO's type of junction, or road.
        episodes: numbers of the episodes, worst first.
        worst: row of the worst of them, which stands for all.
        valid: how many of them are valid failures.
        at_fault: how many by who caused it.
        targets: how many by target and its options as JSON.
    """

    type: str
    junction_type: str
    episodes: tuple[int, ...]
    worst: Row
    valid: int
    at_fault: Mapping[str, int]
    targets: Mapping[tuple[str, str], int]


def findings(episodes: Sequence[Row]) -> list[Finding]:
    """Cluster the target's collisions by type, kind of junction and geometry; that of the most valid failures first.

    Complete linkage under the Chebyshev distance of impact point, approach and speeds, each over its tolerance:
    within a finding no two collisions differ by more than the tolerances.

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
    """Yield rows that belong together, each in the order given."""
    features = np.array([_features(row) for row in rows])
    points, member_of = _points(features)
    labels = np.ones(len(points), dtype=np.int64)
    if len(points) > 1:
        tree = linkage(points, method="complete", metric="chebyshev")
        labels = fcluster(tree, t=1.0, criterion="distance").astype(np.int64)
    label_of_row = labels[member_of]
    for label in sorted(set(label_of_row.tolist()), key=label_of_row.tolist().index):
        yield [row for row, own in zip(rows, label_of_row, strict=True) if own == label]


def _points(features: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return distinct points and which one each row is; coarser where there are very many."""
    points, member_of = np.unique(features, axis=0, return_inverse=True)
    coarse = _COARSE
    while len(points) > _MOST_POINTS:
        points, member_of = np.unique(np.round(features / coarse) * coarse, axis=0, return_inverse=True)
        coarse *= 2.0
    return points, member_of.reshape(-1).astype(np.int64)


def _features(row: Row) -> list[float]:
    """Return the geometry in tolerances; what is undefined is undefined for all of a type or counts as 0."""
    yaw = row["approach_yaw_rad"]
    chord = 2.0 * np.sin(HEADING_RAD / 2.0)
    turned = (0.0, 0.0) if yaw is None else (np.cos(yaw) / chord, np.sin(yaw) / chord)
    lengths = {
        "impact_ahead_m": IMPACT_M,
        "impact_left_m": IMPACT_M,
        "approach_ahead_m": APPROACH_M,
        "approach_left_m": APPROACH_M,
        "target_speed_mps": SPEED_MPS,
        "partner_speed_mps": SPEED_MPS,
    }
    return [*(float(row[name] or 0.0) / unit for name, unit in lengths.items()), *map(float, turned)]
