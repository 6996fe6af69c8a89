"""What an exporter is given and what an importer gives back."""

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

#: Lanes farther than this from every recorded path are left out of formats that carry their own map.
MARGIN_M = 50.0
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*")


@dataclass(frozen=True)
class ExportScene:
    """One episode and the net it happened on.

    Attributes:
        name: stem of the files, of letters, digits, hyphen, underscore and dot.
        tracks: (A, T) states in the net's frame, the first instant at t = 0, everybody there at some instant.
        target: row of the tested vehicle.
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
        """Lanes within ``MARGIN_M`` of where anybody drove, in the net's order."""
        paths = [self.tracks.xy_m[row][self.tracks.valid[row]] for row in range(self.tracks.agents)]
        driven = shapely.STRtree([_path(p) for p in paths])
        lanes = list(self.road.lanes.values())
        lines = [shapely.LineString(lane.centre_xy_m) for lane in lanes]
        near, _ = driven.query(lines, predicate="dwithin", distance=MARGIN_M)
        return tuple(lanes[k] for k in np.unique(near).tolist())

    def joints(self, kept: Collection[str]) -> list[tuple[str, str]]:
        """Return pairs of lanes of *kept* of which the one leads straight to the other, without repeats."""
        chains = ((link.from_lane, *link.via, link.to_lane) for link in self.road.links.values())
        pairs = (pair for chain in chains for pair in pairwise(chain))
        return list(dict.fromkeys(pair for pair in pairs if pair[0] in kept and pair[1] in kept))


def _path(xy_m: FloatArray) -> BaseGeometry:
    """Return the line through points (N, 2); a line of one place is near to nothing."""
    return shapely.Point(xy_m[0]) if (xy_m == xy_m[0]).all() else shapely.LineString(xy_m)


@dataclass(frozen=True)
class ImportedScene:
    """Trajectories read back from an exported file.

    Attributes:
        tracks: (A, T) states, the first instant at t = 0; speeds are derived where the format has none.
        target: row of the tested vehicle.
    """

    tracks: Tracks
    target: int


def plain_names(ids: Sequence[str], pattern: str) -> list[str]:
    """Return unique names that match *pattern*: the ids where they do, ``agent_ROW`` elsewhere."""
    plain = re.compile(pattern)
    taken = {name for name in ids if plain.fullmatch(name)}
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
    """Return headings (T,) without jumps by a turn, so that readers may interpolate them; the first in (−π, π]."""
    return np.asarray(np.unwrap(yaw_rad), dtype=np.float64)


def number(value: float, digits: int = 4) -> str:
    """Return *value* as plain decimal text, never with an exponent and never "-0"."""
    text = f"{value:.{digits}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def seconds(step: int, dt_s: float) -> str:
    """Return the time of *step*, exact to the microsecond, at least one decimal."""
    whole, _, part = f"{step * dt_s:.6f}".partition(".")
    return f"{whole}.{part.rstrip('0') or '0'}"
