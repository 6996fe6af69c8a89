"""Check that a planner in a separate process drives soundly, and in the same way when run again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from tests.e2e.commands import TINY, advdiff, bytes_of


@dataclass(frozen=True)
class DrivenTwice:
    """Two runs of the same command.

    Attributes:
        first, again: files of the two runs, which must be equal.
        episodes: rows of the first run.
    """

    first: dict[str, bytes]
    again: dict[str, bytes]
    episodes: list[dict[str, Any]]

    def unsound(self, least_m: float) -> list[dict[str, Any]]:
        """Return the episodes in which it failed, left the road, or drove at most *least_m* along the route."""
        return [
            row
            for row in self.episodes
            if row["end"] == "failed"
            or row["collision_type"] == "off_road"
            or not row["route_progress_m"] > least_m
        ]


def driven_twice(target: str, horizon_s: int, *options: str, folder: Path) -> DrivenTwice:
    """Run two episodes with *target* twice, in *folder*."""
    words = ("run", *TINY, "--target", target, "--episodes", 2, "--horizon", horizon_s, *options)
    for out in ("one", "two"):
        done = advdiff(*words, "--out", out, cwd=folder)
        assert done.code == 0, done.err
    rows = pq.read_table(folder / "one/episodes.parquet").to_pylist()
    return DrivenTwice(bytes_of(folder / "one"), bytes_of(folder / "two"), rows)
