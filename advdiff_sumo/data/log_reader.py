"""Defines the interface of log readers and the scene that they return."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.scene import Tracks


@dataclass(frozen=True)
class LogScene:
    """A recorded drive with A agents and T keyframes.

    Attributes:
        name: the log's own name of it, such as "scene-0061".
        location: name of the map on which it was driven; "" if the log has none.
        tracks: (A, T) states in the map's frame, first keyframe at t = 0.
        ego: row of the recording vehicle.
        parked: (A,) whether each agent never moves beyond annotation noise.
        source: file or folder from which it was read.
    """

    name: str
    location: str
    tracks: Tracks
    ego: int
    parked: BoolArray
    source: Path


class LogReader(Protocol):
    """Reads one kind of log."""

    def names(self) -> list[str]:
        """Return the names of the scenes, in the log's order."""
        ...

    def read(self, name: str) -> LogScene:
        """Return one scene.

        Raises:
            LogError: the log is damaged; names file, record and remedy.
        """
        ...

    def scenes(self) -> Iterator[LogScene]:
        """Yield all scenes."""
        ...
