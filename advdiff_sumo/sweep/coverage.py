"""Count what a sweep has tried: attack × type of junction × speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, TypeAlias

from advdiff_sumo.metrics.severity import has_outcome

Row: TypeAlias = Mapping[str, Any]

#: Upper bounds of the bands of the target's speed; one more band is above the last.
SPEED_BANDS_MPS = (5.0, 10.0, 15.0)


@dataclass(frozen=True)
class CoverageCell:
    """One combination of attack, type of junction and speed.

    Attributes:
        episodes: episodes with an outcome (finished, or failed after a collision) whose critical moment is in the cell.
        collisions: those of them with a collision of the target.
    """

    episodes: int
    collisions: int


@dataclass(frozen=True)
class Coverage:
    """Counts of all combinations that were possible.

    Attributes:
        attacks: requested attacks.
        junctions: types of junction on the nets, and road.
        cells: (attack, type of junction, band of speed) → counts; empty cells included.
    """

    attacks: tuple[str, ...]
    junctions: tuple[str, ...]
    cells: Mapping[tuple[str, str, str], CoverageCell]

    @property
    def share(self) -> float:
        """Share of the combinations that have an episode."""
        return sum(cell.episodes > 0 for cell in self.cells.values()) / len(self.cells) if self.cells else 0.0


def bands() -> tuple[str, ...]:
    """Return the names of the bands of speed."""
    ends = ("0", *(f"{end:g}" for end in SPEED_BANDS_MPS))
    inner = [f"{low}-{high} m/s" for low, high in pairwise(ends)]
    return (*inner, f"over {ends[-1]} m/s")


def coverage(episodes: Sequence[Row], attacks: Sequence[str], junction_types: Sequence[str]) -> Coverage:
    """Count the *episodes* with an outcome by attack, type of junction and speed at their critical moment.

    Args:
        episodes: rows of a sweep's ``episodes``.
        attacks: requested attacks.
        junction_types: types of junction on the nets.
    """
    counting = [row for row in episodes if has_outcome(row) and row["critical_speed_mps"] is not None]
    names = tuple(dict.fromkeys(attacks))
    junctions = (*sorted({*junction_types, *(str(r["junction_type"]) for r in counting)} - {"road"}), "road")
    counts = {key: [0, 0] for key in product(names, junctions, bands())}
    for row in counting:
        key = (str(row["attack"]), str(row["junction_type"]), _band(float(row["critical_speed_mps"])))
        counted = counts.setdefault(key, [0, 0])
        counted[0] += 1
        counted[1] += bool(row["target_collision"])
    return Coverage(names, junctions, {key: CoverageCell(*counted) for key, counted in counts.items()})


def _band(speed_mps: float) -> str:
    """Return the name of the band that holds *speed_mps*."""
    band_index = sum(abs(speed_mps) >= end for end in SPEED_BANDS_MPS)
    return bands()[band_index]
