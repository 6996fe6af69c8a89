"""Find the conflict area of two links over a junction."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.polylines import Polyline, concatenate
from advdiff_sumo.maps import Link
from advdiff_sumo.planners.lane_graph.path import Geometry, Zone

_CONFLICT_DISTANCE_M = 2.6  # between the centre lines
_BEYOND_M = 6.0  # of the lane beyond the junction is searched, too
_STEP_M = 0.5
_FRONT_M = 2.4  # from the centre of a car to its front


def conflict_zone(geometry: Geometry, own: Link, other: Link) -> Zone | None:
    """Return the conflict area of links *own* and *other*; None if they keep apart."""
    key = (own.from_lane, own.to_lane, other.from_lane, other.to_lane)
    if key not in geometry.conflicts:
        geometry.conflicts[key] = _zone(geometry, own, other)
    return geometry.conflicts[key]


def _zone(geometry: Geometry, own: Link, other: Link) -> Zone | None:
    """Return the conflict area, computed from the centre lines."""
    own_xy, other_xy = _centre_line(geometry, own), _centre_line(geometry, other)
    in_conflict = _are_near(own_xy, other_xy)
    if not in_conflict.any():
        return None
    rows, columns = np.flatnonzero(in_conflict.any(1)), np.flatnonzero(in_conflict.any(0))
    begin_m = float(rows[0] * _STEP_M)
    front_begin_m = _front_reaches_m(geometry, own, other_xy)
    return Zone(
        own_m=(front_begin_m if front_begin_m < begin_m - _STEP_M else begin_m, float(rows[-1] * _STEP_M)),
        other_m=(float(columns[0] * _STEP_M), float(columns[-1] * _STEP_M)),
        merges=own.to_lane == other.to_lane,
    )


def _front_reaches_m(geometry: Geometry, own: Link, other_xy_m: FloatArray) -> float:
    """Return how far beyond its line the front of a car on *own* comes too near to *other_xy_m* (P, 2); inf for never.

    In a tight turn that is earlier than by the centre lines: a car cuts the corner, and its front is outside the bend.
    """
    path = geometry.path((own.from_lane, *own.via, own.to_lane), (own,))
    front_m = np.arange(0.0, path.exit_m[0] - path.stop_m[0] + _BEYOND_M, _STEP_M)
    centre_xy, yaw = path.at(path.stop_m[0] + front_m - _FRONT_M)
    front_xy = centre_xy + _FRONT_M * np.stack((np.cos(yaw), np.sin(yaw)), axis=-1)
    is_near = _are_near(front_xy, other_xy_m).any(axis=1)
    return float(front_m[is_near.argmax()]) if is_near.any() else np.inf


def _are_near(own_xy_m: FloatArray, other_xy_m: FloatArray) -> BoolArray:
    """Return (P, Q) which of P and Q points are too near to each other."""
    distances_m = np.hypot(*(own_xy_m[:, None] - other_xy_m[None]).transpose(2, 0, 1))
    return np.asarray(distances_m < _CONFLICT_DISTANCE_M)


def _centre_line(geometry: Geometry, link: Link) -> FloatArray:
    """Return points (P, 2) of the centre line over *link*, ``_STEP_M`` apart from the stop line on."""
    lanes = geometry.road.lanes
    line = concatenate([lanes[lane].line for lane in (*link.via, link.to_lane)])
    junction_m = sum(lanes[lane].length_m for lane in link.via)
    length_m = min(junction_m + _BEYOND_M, line.length_m)
    return Polyline.at(line, np.arange(0.0, max(length_m, 1.0), _STEP_M))[0]
