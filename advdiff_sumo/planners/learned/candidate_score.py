"""Score the candidates: on the road, clear of others in every sample, on the route, stopping at red lights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners, separation
from advdiff_sumo.core.frames import unit, wrap_angle
from advdiff_sumo.core.resample import with_middles
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.learned.candidates import BRAKE, BRAKES_MPS2, RAW, Candidates
from advdiff_sumo.planners.learned.guide import Guide

# Weights of the costs, which have no unit, and their thresholds.
_COLLISION, _FADE_S, _MARGIN_M = 100.0, 4.0, 0.3  # later collisions cost less: e-fold in 4 s
_OFF_ROAD, _FREE_OFF_ROAD_SHARE = 60.0, 0.02
_RED = 80.0  # passing a red light
_OFFSET, _FREE_OFFSET_M, _MAX_OFFSET_M = 3.0, 0.8, 6.0  # lateral offset from the nearest line
_YAW_ERROR, _FREE_YAW_ERROR_RAD = 8.0, 0.35  # heading relative to that line
_PROGRESS = 3.0
_ON_LINE, _CHANGE, _MISSED_CHANGE = 0.3, 0.8, 4.0  # driving a line; the needed lane change; not making it
_BRAKING = (1.5, 3.0, 6.0)  # by the decelerations of BRAKES_MPS2
_URGENT_M, _RELAXED_M = 30.0, 130.0  # distance left for the lane change: cost is full, or 0
_FOLLOWER_OFFSET_M = 1.8  # largest lateral offset of a follower


@dataclass(frozen=True)
class Around:
    """The N other road users in S samples at T instants.

    Attributes:
        xy_m: (S, N, T, 2) centres.
        yaw_rad: (S, N, T) headings.
        size_m: (N, 2) length and width.
        ignored: (N,) whether it follows the target in its lane; a follower must keep its distance.
    """

    xy_m: FloatArray
    yaw_rad: FloatArray
    size_m: FloatArray
    ignored: BoolArray


def followers(xy_m: FloatArray, yaw_rad: FloatArray, own: tuple[FloatArray, float, float]) -> BoolArray:
    """Return (N,) whether each is behind the target in its lane, with a similar heading.

    Args:
        xy_m: (N, 2) present centres of the others.
        yaw_rad: (N,) their headings.
        own: the target's centre (2,), heading and length.
    """
    forward = unit(np.asarray(own[1]))
    offset = xy_m - own[0]
    ahead_m, lateral_m = offset @ forward, np.abs(offset @ np.array([-forward[1], forward[0]]))
    same_way = np.cos(yaw_rad - own[1]) > 0.5
    return np.asarray((ahead_m < -0.25 * own[2]) & (lateral_m < _FOLLOWER_OFFSET_M) & same_way)


def cost(
    candidates: Candidates,
    around: Around,
    road: RoadMap,
    guide: Guide | None,
    size_m: FloatArray,
    dt_s: float,
) -> FloatArray:
    """Return (C,) the cost of each candidate.

    Args:
        candidates: the candidates.
        around: the others in the samples.
        road: the map.
        guide: lines along the route; None to leave the route out.
        size_m: (2,) length and width of the target.
        dt_s: time step.
    """
    total = _COLLISION * risk(candidates, around, size_m, dt_s) + _OFF_ROAD * off_road(
        candidates, road, size_m
    )
    total += np.where(candidates.line == RAW, 0.0, _ON_LINE)
    braking = np.flatnonzero(candidates.line == BRAKE)
    total[braking] += np.array(_BRAKING)[: len(braking)] * (len(braking) == len(BRAKES_MPS2))
    if guide is not None:
        total += _route_cost(candidates, guide, dt_s)
    return np.asarray(total)


def risk(candidates: Candidates, around: Around, size_m: FloatArray, dt_s: float) -> FloatArray:
    """Return (C,) the risk of collision, from 0 to 1: the mean over the samples; earlier collisions count more."""
    xy, yaw = with_middles(candidates.xy_m, candidates.yaw_rad)
    other_xy, other_yaw = with_middles(around.xy_m, around.yaw_rad)
    samples, count = other_xy.shape[:2]
    weights = np.zeros((len(xy), samples))
    if not count:
        return np.zeros(len(xy))
    reach_m = 0.5 * (np.hypot(*around.size_m.T) + np.hypot(*size_m)) + _MARGIN_M
    gap = np.hypot(*np.moveaxis(xy[:, None, None] - other_xy[None], -1, 0))  # (C, S, N, 2 T)
    c, s, n, t = np.nonzero((gap < reach_m[:, None]) & ~around.ignored[:, None])
    if not len(c):
        return np.zeros(len(xy))
    own_corners = corners(xy[c, t], yaw[c, t], size_m + 2.0 * np.array([_MARGIN_M, 0.5 * _MARGIN_M]))
    overlaps = separation(own_corners, corners(other_xy[s, n, t], other_yaw[s, n, t], around.size_m[n])) < 0.0
    weight = np.where(overlaps, np.exp(-0.5 * dt_s * t / _FADE_S), 0.0)
    np.maximum.at(weights, (c, s), weight)
    return np.asarray(weights.mean(1))


def off_road(candidates: Candidates, road: RoadMap, size_m: FloatArray) -> FloatArray:
    """Return (C,) the largest share of the footprint off the drivable area, above the tolerated share."""
    boxes = corners(
        candidates.xy_m, candidates.yaw_rad, np.broadcast_to(size_m, (*candidates.yaw_rad.shape, 2))
    )
    shares = np.zeros(candidates.yaw_rad.shape)
    outside = ~road.covers(boxes).all(-1)
    if outside.any():
        shares[outside] = road.off_road_share(boxes[outside])
    return np.asarray(np.maximum(shares.max(1) - _FREE_OFF_ROAD_SHARE, 0.0))


def _route_cost(candidates: Candidates, guide: Guide, dt_s: float) -> FloatArray:
    """Return (C,) the cost of leaving the lines, passing a red light, little progress, and a missed lane change."""
    lines = guide.lines
    line_of = np.maximum(candidates.line, 0)
    s, offset, yaw_error = (np.empty(candidates.yaw_rad.shape) for _ in range(3))
    s[:], d = lines[0].path.project(candidates.xy_m)
    offset[:], yaw_error[:] = np.abs(d), np.abs(wrap_angle(candidates.yaw_rad - lines[0].path.at(s)[1]))
    for line in lines[1:]:
        side_s, side_d = line.path.project(candidates.xy_m)
        is_nearer = np.abs(side_d) < offset
        offset[is_nearer] = np.abs(side_d)[is_nearer]
        yaw_error[is_nearer] = np.abs(wrap_angle(candidates.yaw_rad - line.path.at(side_s)[1]))[is_nearer]
    end_offset = np.clip(offset[:, -1] - _FREE_OFFSET_M, 0.0, _MAX_OFFSET_M)
    total = _OFFSET * end_offset + _YAW_ERROR * np.maximum(yaw_error[:, -1] - _FREE_YAW_ERROR_RAD, 0.0)
    state, keep = guide.state, lines[0]
    overrun_m = s.max(1) + state.front_m - guide.stop_m
    total += _RED * np.clip(overrun_m, 0.0, 1.0)
    limit = float(keep.path.limit_mps[min(max(int(keep.s_m), 0), len(keep.path.limit_mps) - 1)])
    desired_m = max(limit * dt_s * candidates.yaw_rad.shape[1], 5.0)
    total -= _PROGRESS * np.minimum((s[:, -1] - keep.s_m) / desired_m, 1.0)
    if len(lines) > 1:
        room_m = keep.path.length_m - keep.s_m - state.front_m
        urgency = np.clip(1.0 - (room_m - _URGENT_M) / (_RELAXED_M - _URGENT_M), 0.0, 1.0)
        total += np.where(line_of == 1, _CHANGE, _MISSED_CHANGE * urgency)
    return np.asarray(total)
