"""Which candidate is driven: on the road, clear of everybody in every sample, on the route, before red lights."""

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

_COLLISION, _FADE_S, _MARGIN_M = 100.0, 4.0, 0.3
_OFF_ROAD, _OFF_FREE = 60.0, 0.02
_RED = 80.0
_ASIDE, _ASIDE_FREE_M, _ASIDE_MOST_M = 3.0, 0.8, 6.0
_ACROSS, _ACROSS_FREE_RAD = 8.0, 0.35
_PROGRESS = 3.0
_ON_LINE, _CHANGE, _NEEDED = 0.3, 0.8, 4.0
_BRAKING = (1.5, 3.0, 6.0)
_NEAR_M, _FAR_M = 30.0, 130.0
_BEHIND_SIDE_M = 1.8


@dataclass(frozen=True)
class Around:
    """The others in S samples: N of them at T instants.

    Attributes:
        xy_m: (S, N, T, 2) centres.
        yaw_rad: (S, N, T) headings.
        size_m: (N, 2) length and width.
        ignored: (N,) who follows the target in its lane and must keep the distance.
    """

    xy_m: FloatArray
    yaw_rad: FloatArray
    size_m: FloatArray
    ignored: BoolArray


def followers(xy_m: FloatArray, yaw_rad: FloatArray, own: tuple[FloatArray, float, float]) -> BoolArray:
    """Return (N,) who is behind the target in its lane, looking the same way.

    Args:
        xy_m: (N, 2) the others' centres now.
        yaw_rad: (N,) their headings.
        own: the target's centre (2,), heading and length.
    """
    ahead = unit(np.asarray(own[1]))
    delta = xy_m - own[0]
    along, beside = delta @ ahead, np.abs(delta @ np.array([-ahead[1], ahead[0]]))
    same = np.cos(yaw_rad - own[1]) > 0.5
    return np.asarray((along < -0.25 * own[2]) & (beside < _BEHIND_SIDE_M) & same)


def cost(
    candidates: Candidates,
    around: Around,
    road: RoadMap,
    guide: Guide | None,
    size_m: FloatArray,
    dt_s: float,
) -> FloatArray:
    """Return (C,) what each candidate costs.

    Args:
        candidates: the candidates.
        around: the others in the samples.
        road: the map.
        guide: the route, where there is any.
        size_m: (2,) length and width of the target.
        dt_s: spacing.
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
    """Return (C,) the share of samples in which a candidate meets somebody, sooner counting more."""
    xy, yaw = with_middles(candidates.xy_m, candidates.yaw_rad)
    theirs, turned = with_middles(around.xy_m, around.yaw_rad)
    samples, count = theirs.shape[:2]
    hit = np.zeros((len(xy), samples))
    if not count:
        return np.zeros(len(xy))
    reach = 0.5 * (np.hypot(*around.size_m.T) + np.hypot(*size_m)) + _MARGIN_M
    gap = np.hypot(*np.moveaxis(xy[:, None, None] - theirs[None], -1, 0))  # (C, S, N, 2 T)
    c, s, n, t = np.nonzero((gap < reach[:, None]) & ~around.ignored[:, None])
    if not len(c):
        return np.zeros(len(xy))
    mine = corners(xy[c, t], yaw[c, t], size_m + 2.0 * np.array([_MARGIN_M, 0.5 * _MARGIN_M]))
    touching = separation(mine, corners(theirs[s, n, t], turned[s, n, t], around.size_m[n])) < 0.0
    weight = np.where(touching, np.exp(-0.5 * dt_s * t / _FADE_S), 0.0)
    np.maximum.at(hit, (c, s), weight)
    return np.asarray(hit.mean(1))


def off_road(candidates: Candidates, road: RoadMap, size_m: FloatArray) -> FloatArray:
    """Return (C,) the largest share of the box off the drivable area, beyond what is common."""
    boxes = corners(
        candidates.xy_m, candidates.yaw_rad, np.broadcast_to(size_m, (*candidates.yaw_rad.shape, 2))
    )
    out = np.zeros(candidates.yaw_rad.shape)
    outside = ~road.covers(boxes).all(-1)
    if outside.any():
        out[outside] = road.off_road_share(boxes[outside])
    return np.asarray(np.maximum(out.max(1) - _OFF_FREE, 0.0))


def _route_cost(candidates: Candidates, guide: Guide, dt_s: float) -> FloatArray:
    lines = guide.lines
    which = np.maximum(candidates.line, 0)
    s, aside, across = (np.empty(candidates.yaw_rad.shape) for _ in range(3))
    s[:], d = lines[0].path.project(candidates.xy_m)
    aside[:], across[:] = np.abs(d), np.abs(wrap_angle(candidates.yaw_rad - lines[0].path.at(s)[1]))
    for line in lines[1:]:
        beside_s, beside = line.path.project(candidates.xy_m)
        nearer = np.abs(beside) < aside
        aside[nearer] = np.abs(beside)[nearer]
        across[nearer] = np.abs(wrap_angle(candidates.yaw_rad - line.path.at(beside_s)[1]))[nearer]
    end_aside = np.clip(aside[:, -1] - _ASIDE_FREE_M, 0.0, _ASIDE_MOST_M)
    total = _ASIDE * end_aside + _ACROSS * np.maximum(across[:, -1] - _ACROSS_FREE_RAD, 0.0)
    state, keep = guide.state, lines[0]
    over = s.max(1) + state.front_m - guide.stop_m
    total += _RED * np.clip(over, 0.0, 1.0)
    limit = float(keep.path.limit_mps[min(max(int(keep.s_m), 0), len(keep.path.limit_mps) - 1)])
    wanted = max(limit * dt_s * candidates.yaw_rad.shape[1], 5.0)
    total -= _PROGRESS * np.minimum((s[:, -1] - keep.s_m) / wanted, 1.0)
    if len(lines) > 1:
        left = keep.path.length_m - keep.s_m - state.front_m
        urgent = np.clip(1.0 - (left - _NEAR_M) / (_FAR_M - _NEAR_M), 0.0, 1.0)
        total += np.where(which == 1, _CHANGE, _NEEDED * urgent)
    return np.asarray(total)
