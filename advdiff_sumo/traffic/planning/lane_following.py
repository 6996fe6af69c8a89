"""What vehicles would drive that simply follow their lanes, many of them at once."""

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
    """Return states (V, T, 2), (V, T), (V, T) of V vehicles that follow their lanes at the limit, slower for bends.

    Pure pursuit through the bicycle model; other vehicles and signals are the business of ``braking``.

    Args:
        lanes: of each vehicle.
        xy_m: (V, 2) centres.
        yaw_rad: (V,) headings.
        speed_mps: (V,) speeds.
        length_m: (V,) lengths.
        steps: T.
        dt_s: spacing.
    """
    limits = Limits()
    states = np.column_stack((xy_m, yaw_rad, np.maximum(speed_mps, 0.0)))
    bends = np.tan(limits.steer_rad) / wheelbase_m(length_m)
    small_s, count = dt_s / _SUBSTEPS, _SUBSTEPS * steps
    driven = pursue(lines_of(lanes), states, bends, limits.lateral_mps2, small_s, count)
    last = driven[:, _SUBSTEPS - 1 :: _SUBSTEPS]
    return last[..., :2], last[..., 2], last[..., 3]


def approach_mps(lane: LaneAhead) -> float:
    """Return the speed on *lane* now that keeps its limit and comes down in time to what is driven ahead.

    The limits of lanes on junctions count as they are: the speed at which a bend can be driven.
    """
    slowest, reach = lane.lanes[0].speed_mps, lane.lanes[0].length_m - lane.s_m
    for part in lane.lanes[1:]:  # plain numbers: this is asked for every vehicle of every plan
        if part.speed_mps < slowest:
            slowest = min(slowest, math.sqrt(part.speed_mps**2 + 2.0 * EASE_MPS2 * max(reach, 0.0)))
        reach += part.length_m
    return slowest


def lines_of(lanes: Sequence[LaneAhead]) -> Lines:
    """Return the lines of vehicles on *lanes*."""
    parts = [x.centre_xy_m for lane in lanes for x in lane.lanes]
    points = np.concatenate(parts)
    pieces = np.array([len(lane.lanes) for lane in lanes])
    counts = np.array([len(part) for part in parts])
    line = np.repeat(np.repeat(np.arange(len(lanes)), pieces), counts)
    keep = kept_points(points) | (np.diff(line, prepend=-1) > 0)  # a line keeps its first point
    points, line = points[keep], line[keep]
    within = line[1:] == line[:-1]
    delta = (points[1:] - points[:-1])[within]
    length = np.hypot(delta[:, 0], delta[:, 1])
    owner = line[:-1][within]
    first = np.searchsorted(owner, np.arange(len(lanes)))
    last = np.searchsorted(owner, np.arange(len(lanes)), side="right") - 1
    # line by line: the same vehicle among others gets the same numbers
    s = np.concatenate([np.cumsum(part) - part for part in np.split(length, first[1:])])
    tangent = delta / length[:, None]
    yaw = np.arctan2(tangent[:, 1], tangent[:, 0])
    begin, limit = np.array([(lane.s_m, approach_mps(lane)) for lane in lanes], dtype=np.float64).T.copy()
    return Lines(points[:-1][within], tangent, yaw, s, first, last, begin, limit)
