"""Defines the scene that an exporter writes and the one that an importer returns, and texts that exporters share."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import Lane, RoadMap

#: Lanes farther than this from all recorded paths are left out of formats that contain a map.
MARGIN_M = 50.0
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*")


@dataclass(frozen=True)
class ExportScene:
    """An episode and its net.

    Attributes:
        name: stem of the files; letters, digits, hyphens, underscores and dots.
        tracks: (A, T) states in the net's frame, first instant at t = 0; each agent is present at some instant.
        target: row of the target.
        road: the net.
    """

    name: str
    tracks: Tracks
    target: int
    road: RoadMap

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"'{self.name}' is no name for files")
        if self.tracks.t0_s != 0.0:
            raise ValueError(f"the first instant is at {self.tracks.t0_s} s, not at 0")
        if not self.tracks.valid.any(axis=1).all():
            raise ValueError("there is an agent that is never there")

    @cached_property
    def lanes(self) -> tuple[Lane, ...]:
        """Lanes within ``MARGIN_M`` of the path of any agent, in the net's order."""
        paths = [self.tracks.xy_m[row][self.tracks.valid[row]] for row in range(self.tracks.agents)]
        path_tree = shapely.STRtree([_path(p) for p in paths])
        lanes = list(self.road.lanes.values())
        lines = [shapely.LineString(lane.centre_xy_m) for lane in lanes]
        near_rows, _ = path_tree.query(lines, predicate="dwithin", distance=MARGIN_M)
        return tuple(lanes[k] for k in np.unique(near_rows).tolist())

    def joints(self, kept: Collection[str]) -> list[tuple[str, str]]:
        """Return the distinct pairs of lanes in *kept* of which the first leads directly to the second."""
        chains = ((link.from_lane, *link.via, link.to_lane) for link in self.road.links.values())
        pairs = (pair for chain in chains for pair in pairwise(chain))
        return list(dict.fromkeys(pair for pair in pairs if pair[0] in kept and pair[1] in kept))


def _path(xy_m: FloatArray) -> BaseGeometry:
    """Return the line through points (N, 2); a point if all are equal, as nothing is near a line without length."""
    return shapely.Point(xy_m[0]) if (xy_m == xy_m[0]).all() else shapely.LineString(xy_m)


@dataclass(frozen=True)
class ImportedScene:
    """The trajectories read from an exported file.

    Attributes:
        tracks: (A, T) states, first instant at t = 0; speeds are derived from positions if the format has none.
        target: row of the target.
    """

    tracks: Tracks
    target: int


def plain_names(ids: Sequence[str], pattern: str) -> list[str]:
    """Return unique names that match *pattern*: each id that does, ``agent_ROW`` for the others."""
    permitted = re.compile(pattern)
    taken = {name for name in ids if permitted.fullmatch(name)}
    names = []
    for row, name in enumerate(ids):
        if name not in taken:
            name = f"agent_{row}"
            while name in taken:
                name += "_"
            taken.add(name)
        names.append(name)
    return names


def unwrapped(yaw_rad: FloatArray) -> FloatArray:
    """Return headings (T,) without jumps by 2π, so that readers can interpolate them; the first is in (−π, π]."""
    return np.asarray(np.unwrap(yaw_rad), dtype=np.float64)


def decimal_text(value: float, digits: int = 4) -> str:
    """Return *value* as decimal text, without an exponent and never as "-0"."""
    text = f"{value:.{digits}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def seconds_text(step: int, dt_s: float) -> str:
    """Return the time of *step* as text, exact to the microsecond, with at least one decimal."""
    whole, _, part = f"{step * dt_s:.6f}".partition(".")
    return f"{whole}.{part.rstrip('0') or '0'}"
