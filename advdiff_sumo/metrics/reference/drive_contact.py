"""Whom a drive touches among recorded others, how hard, and how near it comes to one of them."""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.boxes import axis_gaps, corners, distance
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.continuous_collision import Sweep, first_contact


def first_touch(drive: Trajectory, others: Tracks, target: int) -> tuple[int, int, float] | None:
    """Return instant, row and closing speed of the drive's first contact; None without one."""
    size = others.size_m
    offset = others.xy_m[:, :-1] - drive.xy_m[:-1]
    moves = np.hypot(*np.moveaxis(np.diff(others.xy_m, axis=1), -1, 0))
    own = np.hypot(*np.diff(drive.xy_m, axis=0).T)
    reach = 0.5 * (np.hypot(*size.T) + np.hypot(*size[target]))[:, None] + moves + own
    with np.errstate(invalid="ignore"):
        near = np.hypot(offset[..., 0], offset[..., 1]) <= reach
    near[target] = False
    row, step = np.nonzero(near)
    if not row.size:
        return None
    a = Sweep.between(
        drive.xy_m[step],
        drive.yaw_rad[step],
        drive.xy_m[step + 1],
        drive.yaw_rad[step + 1],
        np.broadcast_to(size[target], (len(row), 2)),
    )
    b = Sweep.between(
        others.xy_m[row, step],
        others.yaw_rad[row, step],
        others.xy_m[row, step + 1],
        others.yaw_rad[row, step + 1],
        size[row],
    )
    fraction = first_contact(a, b)
    if np.isnan(fraction).all():
        return None
    first = int(np.nanargmin(step + fraction))
    return int(step[first]), int(row[first]), _closing_mps(a, b, first, float(fraction[first]), others.dt_s)


def _closing_mps(a: Sweep, b: Sweep, pair: int, fraction: float, dt_s: float) -> float:
    """Return the speed at which the boxes of *pair* approach along their contact normal."""
    picked = np.array([pair])
    a, b = a.rows(picked), b.rows(picked)
    (xy_a, yaw_a), (xy_b, yaw_b) = a.pose(fraction), b.pose(fraction)
    gaps, along, axes = axis_gaps(xy_b - xy_a, yaw_a, a.half_m, yaw_b, b.half_m)
    best = int(np.argmax(gaps[0]))
    normal = np.copysign(1.0, along[0, best]) * axes[0, best]
    return max(0.0, float((a.move_m[0] - b.move_m[0]) @ normal) / dt_s)


def least_gap_m(drive: Trajectory, others: Tracks, target: int, partner: int, length: int) -> float:
    """Return the least distance between the drive's box and that of *partner* over the first *length* instants."""
    steps = np.arange(length)
    own = corners(
        drive.xy_m[steps], drive.yaw_rad[steps], np.broadcast_to(others.size_m[target], (length, 2))
    )
    size = np.broadcast_to(others.size_m[partner], (length, 2))
    theirs = corners(others.xy_m[partner, steps], others.yaw_rad[partner, steps], size)
    gap = distance(own, theirs)
    return float(np.nanmin(gap)) if np.isfinite(gap).any() else float("inf")
