"""Predicts the motion of vehicles that follow their lanes, many vehicles at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.bicycle import Limits, wheelbase_m
from advdiff_sumo.core.polylines import kept_points
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.planning.pursuit import Lines, pursue
from advdiff_sumo.traffic.planning.speed_bound import EASE_MPS2

_SUBSTEPS = 2


def follow(
    lanes: Sequence[LaneAhead],
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    length_m: FloatArray,
    steps: int,
    dt_s: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the future of V vehicles that follow their lanes at the speed limit, slower in bends.

    Pure pursuit drives the bicycle model. Other vehicles and signals are ignored; ``braking`` handles them.

    Args:
        lanes: lanes of each vehicle.
        xy_m: (V, 2) centres.
        yaw_rad: (V,) headings.
        speed_mps: (V,) speeds.
        length_m: (V,) lengths.
        steps: number of future instants T.
        dt_s: spacing.

    Returns:
        Centres (V, T, 2), headings (V, T) and speeds (V, T).
    """
    limits = Limits()
    states = np.column_stack((xy_m, yaw_rad, np.maximum(speed_mps, 0.0)))
    max_curvature = np.tan(limits.steer_rad) / wheelbase_m(length_m)
    substep_s, count = dt_s / _SUBSTEPS, _SUBSTEPS * steps
    driven = pursue(lines_of(lanes), states, max_curvature, limits.lateral_mps2, substep_s, count)
    sampled = driven[:, _SUBSTEPS - 1 :: _SUBSTEPS]
    return sampled[..., :2], sampled[..., 2], sampled[..., 3]


def approach_mps(lane: LaneAhead) -> float:
    """Return the highest speed now that keeps the limit here and can be reduced in time for lower ones ahead.

    Limits on junctions count unchanged: they are the speeds at which bends can be driven.
    """
    speed, distance = lane.lanes[0].speed_mps, lane.lanes[0].length_m - lane.s_m
    for part in lane.lanes[1:]:  # no arrays, for speed: this runs for every vehicle of every plan
        if part.speed_mps < speed:
            speed = min(speed, math.sqrt(part.speed_mps**2 + 2.0 * EASE_MPS2 * max(distance, 0.0)))
        distance += part.length_m
    return speed


def lines_of(lanes: Sequence[LaneAhead]) -> Lines:
    """Return the centre lines of the lanes of V vehicles."""
    parts = [part.centre_xy_m for lane in lanes for part in lane.lanes]
    points = np.concatenate(parts)
    lane_counts = np.array([len(lane.lanes) for lane in lanes])
    point_counts = np.array([len(part) for part in parts])
    line = np.repeat(np.repeat(np.arange(len(lanes)), lane_counts), point_counts)
    keep = kept_points(points) | (np.diff(line, prepend=-1) > 0)  # a line keeps its first point
    points, line = points[keep], line[keep]
    same_line = line[1:] == line[:-1]
    delta = (points[1:] - points[:-1])[same_line]
    length = np.hypot(delta[:, 0], delta[:, 1])
    owner = line[:-1][same_line]
    first = np.searchsorted(owner, np.arange(len(lanes)))
    last = np.searchsorted(owner, np.arange(len(lanes)), side="right") - 1
    # summed line by line, so that a vehicle gets the same numbers whatever the other vehicles are
    s = np.concatenate([np.cumsum(part) - part for part in np.split(length, first[1:])])
    tangent = delta / length[:, None]
    yaw = np.arctan2(tangent[:, 1], tangent[:, 0])
    begin, limit = np.array([(lane.s_m, approach_mps(lane)) for lane in lanes], dtype=np.float64).T.copy()
    return Lines(points[:-1][same_line], tangent, yaw, s, first, last, begin, limit)
