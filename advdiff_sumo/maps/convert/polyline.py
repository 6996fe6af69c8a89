"""Geometry of polylines (N, 2) in m, by arc length."""

from __future__ import annotations

import math

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.polylines import line_length_m, stations_m


def at(line: FloatArray, s_m: FloatArray | float) -> FloatArray:
    """Return the points (…, 2) at arc lengths *s_m*; beyond the line, its end points."""
    s = stations_m(line)
    return np.stack([np.interp(s_m, s, line[:, 0]), np.interp(s_m, s, line[:, 1])], axis=-1)


def heading(line: FloatArray, s_m: FloatArray) -> FloatArray:
    """Return the yaw (M,) in rad of the line segment at each arc length."""
    s = stations_m(line)
    index = np.clip(np.searchsorted(s, s_m, side="right") - 1, 0, len(line) - 2)
    step = line[index + 1] - line[index]
    return np.asarray(np.arctan2(step[:, 1], step[:, 0]))


def turns(line: FloatArray) -> FloatArray:
    """Return the change of heading (N − 2,) in rad at each inner point of the line, left positive."""
    step = np.diff(line, axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    return np.asarray((np.diff(yaw) + math.pi) % (2.0 * math.pi) - math.pi)


def turn_between(before: FloatArray, after: FloatArray) -> float:
    """Return the change of heading in rad from the end of one line to the beginning of another, left positive."""
    last, first = before[-1] - before[-2], after[1] - after[0]
    return math.atan2(last[0] * first[1] - last[1] * first[0], float(last @ first))


def direction(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the unit vector (2,) from point *start* to point *end*."""
    return np.asarray((end - start) / np.hypot(*(end - start)))


def left_of(along: FloatArray) -> FloatArray:
    """Return the vector (2,) *along* turned left by 90°."""
    return np.array([-along[1], along[0]])


def cut(line: FloatArray, from_m: float, to_m: float) -> FloatArray:
    """Return the part of *line* between two arc lengths, which are limited to the line."""
    s = stations_m(line)
    if from_m <= 0.0 and to_m >= s[-1]:
        return line
    inner = (s > from_m + 1e-6) & (s < to_m - 1e-6)
    ends = at(line, np.array([max(from_m, 0.0), min(to_m, s[-1])]))
    return np.vstack((ends[:1], line[inner], ends[1:]))


def project(line: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project *points* (M, 2) onto *line*; return arc lengths (M,) and lateral offsets (M,) in m, left positive."""
    start, step = line[:-1], np.diff(line, axis=0)
    squared = np.maximum((step**2).sum(1), 1e-18)
    delta = points[:, None, :] - start  # (M, N-1, 2)
    share = np.clip((delta * step).sum(-1) / squared, 0.0, 1.0)
    offset = delta - share[..., None] * step
    distance = np.hypot(offset[..., 0], offset[..., 1])
    nearest = distance.argmin(1)
    row = np.arange(len(points))
    side = np.sign(step[nearest, 0] * delta[row, nearest, 1] - step[nearest, 1] * delta[row, nearest, 0])
    s = stations_m(line)[nearest] + share[row, nearest] * np.sqrt(squared[nearest])
    return s, np.where(side == 0, 1.0, side) * distance[row, nearest]


def resample(line: FloatArray, step_m: float) -> tuple[FloatArray, FloatArray]:
    """Return points (M, 2) at most about *step_m* apart, and their arc lengths (M,); both ends are included."""
    total = line_length_m(line)
    s = np.linspace(0.0, total, max(2, int(np.ceil(total / step_m)) + 1))
    return at(line, s), s


def join(parts: list[FloatArray]) -> FloatArray:
    """Return consecutive polylines as one; a point that two of them share appears once."""
    whole = parts[0]
    for part in parts[1:]:
        first = 1 if np.hypot(*(part[0] - whole[-1])) < 1e-6 else 0
        whole = np.vstack((whole, part[first:]))
    return whole


def shape_text(points: FloatArray) -> str:
    """Return "x,y x,y …" in m with four decimals."""
    return " ".join(f"{x:.4f},{y:.4f}" for x, y in points)
