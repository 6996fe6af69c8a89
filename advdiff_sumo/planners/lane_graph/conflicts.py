"""Find the conflict area of two links over a junction."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.polylines import distances_m
from advdiff_sumo.maps import Link
from advdiff_sumo.maps.link_points import points_over
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
    """Return the conflict area, computed from the centre lines.

    In a tight turn it begins earlier, or exists at all, because the front of a car is outside the line that it drives.
    """
    other_xy = _centre_line(geometry, other)
    by_centre = _are_near(_centre_line(geometry, own), other_xy)
    by_front = _are_near(_front_line(geometry, own), other_xy)
    in_conflict = by_centre if by_centre.any() else by_front
    if not in_conflict.any():
        return None
    rows, columns = np.flatnonzero(in_conflict.any(1)), np.flatnonzero(in_conflict.any(0))
    begin, front_begin = rows[0], np.flatnonzero(by_front.any(1))[:1]
    if len(front_begin) and front_begin[0] < begin - 1:
        begin = front_begin[0]
    return Zone(
        own_m=(float(begin * _STEP_M), float(rows[-1] * _STEP_M)),
        other_m=(float(columns[0] * _STEP_M), float(columns[-1] * _STEP_M)),
        merges=own.to_lane == other.to_lane,
    )


def _front_line(geometry: Geometry, link: Link) -> FloatArray:
    """Return points (P, 2) of a car's front as it drives over *link*, ``_STEP_M`` apart from the stop line on."""
    path = geometry.path((link.from_lane, *link.via, link.to_lane), (link,))
    front_m = np.arange(0.0, path.exit_m[0] - path.stop_m[0] + _BEYOND_M, _STEP_M)
    centre_xy, yaw = path.at(path.stop_m[0] + front_m - _FRONT_M)
    return centre_xy + _FRONT_M * unit(yaw)


def _are_near(own_xy_m: FloatArray, other_xy_m: FloatArray) -> BoolArray:
    """Return (P, Q) which of P and Q points are too near to each other."""
    return np.asarray(distances_m(own_xy_m, other_xy_m) < _CONFLICT_DISTANCE_M)


def _centre_line(geometry: Geometry, link: Link) -> FloatArray:
    """Return points (P, 2) of the centre line over *link*, ``_STEP_M`` apart from the stop line on."""
    return points_over(geometry.road, link, _BEYOND_M, _STEP_M, least_m=1.0)
