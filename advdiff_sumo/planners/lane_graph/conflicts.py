"""Where two ways over a junction meet."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.maps import Link
from advdiff_sumo.planners.lane_graph.path import Geometry, Zone

_NEAR_M = 2.6
_BEYOND_M = 6.0
_STEP_M = 0.5


def conflict_zone(geometry: Geometry, own: Link, other: Link) -> Zone | None:
    """Return where vehicles on *own* and *other* would collide, or None when their ways stay apart."""
    key = (own.from_lane, own.to_lane, other.from_lane, other.to_lane)
    if key not in geometry.conflicts:
        geometry.conflicts[key] = _zone(geometry, own, other)
    return geometry.conflicts[key]


def _zone(geometry: Geometry, own: Link, other: Link) -> Zone | None:
    a, b = _way(geometry, own), _way(geometry, other)
    near = np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1)) < _NEAR_M
    if not near.any():
        return None
    rows, columns = np.flatnonzero(near.any(1)), np.flatnonzero(near.any(0))
    return Zone(
        own_m=(float(rows[0] * _STEP_M), float(rows[-1] * _STEP_M)),
        other_m=(float(columns[0] * _STEP_M), float(columns[-1] * _STEP_M)),
        merges=own.to_lane == other.to_lane,
    )


def _way(geometry: Geometry, link: Link) -> FloatArray:
    lanes = geometry.road.lanes
    line = concatenate([lanes[lane].line for lane in (*link.via, link.to_lane)])
    inside = sum(lanes[lane].length_m for lane in link.via)
    stop = min(inside + _BEYOND_M, line.length_m)
    return Polyline.at(line, np.arange(0.0, max(stop, 1.0), _STEP_M))[0]
