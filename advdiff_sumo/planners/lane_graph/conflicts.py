"""Find the conflict area of two links over a junction."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.maps import Link
from advdiff_sumo.planners.lane_graph.path import Geometry, Zone

_CONFLICT_DISTANCE_M = 2.6  # between the centre lines
_BEYOND_M = 6.0  # of the lane beyond the junction is searched, too
_STEP_M = 0.5


def conflict_zone(geometry: Geometry, own: Link, other: Link) -> Zone | None:
    """Return the conflict area of links *own* and *other*; None if they keep apart."""
    key = (own.from_lane, own.to_lane, other.from_lane, other.to_lane)
    if key not in geometry.conflicts:
        geometry.conflicts[key] = _zone(geometry, own, other)
    return geometry.conflicts[key]


def _zone(geometry: Geometry, own: Link, other: Link) -> Zone | None:
    """Return the conflict area, computed from the centre lines."""
    own_xy, other_xy = _centre_line(geometry, own), _centre_line(geometry, other)
    in_conflict = np.hypot(*(own_xy[:, None] - other_xy[None]).transpose(2, 0, 1)) < _CONFLICT_DISTANCE_M
    if not in_conflict.any():
        return None
    rows, columns = np.flatnonzero(in_conflict.any(1)), np.flatnonzero(in_conflict.any(0))
    return Zone(
        own_m=(float(rows[0] * _STEP_M), float(rows[-1] * _STEP_M)),
        other_m=(float(columns[0] * _STEP_M), float(columns[-1] * _STEP_M)),
        merges=own.to_lane == other.to_lane,
    )


def _centre_line(geometry: Geometry, link: Link) -> FloatArray:
    """Return points (P, 2) of the centre line over *link*, ``_STEP_M`` apart from the stop line on."""
    lanes = geometry.road.lanes
    line = concatenate([lanes[lane].line for lane in (*link.via, link.to_lane)])
    junction_m = sum(lanes[lane].length_m for lane in link.via)
    length_m = min(junction_m + _BEYOND_M, line.length_m)
    return Polyline.at(line, np.arange(0.0, max(length_m, 1.0), _STEP_M))[0]
