"""Whom a drive collides with among recorded others, how hard, and how near it comes to one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import corners, distance
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.contact import JUMP_MPS
from advdiff_sumo.metrics.continuous_collision import Sweep, first_contact, gaps_at


@dataclass(frozen=True)
class Touch:
    """The first contact of a drive with one of the others.

    Attributes:
        step: instant before it, counted as those of the drive's record.
        name: id of the other.
        closing_mps: speed at which the boxes approach along their contact normal.
        from_behind: the other's centre is behind the drive's rear at that instant.
        from_start: the two overlapped already as the drive began.
    """

    step: int
    name: str
    closing_mps: float
    from_behind: bool
    from_start: bool = False


def touches(drive: Trajectory, others: Tracks, target: int, first_step: int) -> tuple[Touch, ...]:
    """Return the first contact with each of *others* that the drive collides with, in their order.

    Args:
        drive: (T,) states.
        others: whoever is there at the same T instants, the target included.
        target: its row.
        first_step: count of the first instant in the record.
    """
    row, step = _within_reach(drive, others, target)
    if not row.size:
        return ()
    a, b = _sweeps(drive, others, target, row, step)
    fraction = first_contact(a, b)
    touched = np.flatnonzero(np.isfinite(fraction))
    in_order = touched[np.argsort((step + fraction)[touched], kind="stable")]
    _, firsts = np.unique(row[in_order], return_index=True)
    behind = is_behind(others.xy_m, drive.xy_m, drive.yaw_rad, others.size_m[target, 0])
    return tuple(
        Touch(
            first_step + int(step[pair]),
            others.ids[row[pair]],
            _closing_mps(a, b, pair, float(fraction[pair]), others.dt_s),
            bool(behind[row[pair], step[pair]]),
            bool(step[pair] + fraction[pair] == 0.0),
        )
        for pair in in_order[np.sort(firsts)].tolist()
    )


def _within_reach(drive: Trajectory, others: Tracks, target: int) -> tuple[IntArray, IntArray]:
    """Return rows and instants of others so near that they might touch the drive before the next instant.

    Whoever jumps is not swept, as in :func:`~advdiff_sumo.metrics.contact.contacts`.
    """
    size = others.size_m
    offset = others.xy_m[:, :-1] - drive.xy_m[:-1]
    moves = np.hypot(*np.moveaxis(np.diff(others.xy_m, axis=1), -1, 0))
    own = np.hypot(*np.diff(drive.xy_m, axis=0).T)
    reach = 0.5 * (np.hypot(*size.T) + np.hypot(*size[target]))[:, None] + moves + own
    with np.errstate(invalid="ignore"):
        near = (np.hypot(offset[..., 0], offset[..., 1]) <= reach) & (moves <= JUMP_MPS * others.dt_s)
    near[target] = False
    row, step = np.nonzero(near)
    return row, step


def _sweeps(
    drive: Trajectory, others: Tracks, target: int, row: IntArray, step: IntArray
) -> tuple[Sweep, Sweep]:
    """Return the motion of the drive and of the others of *row* between instants *step* and the next ones."""
    own = Sweep.between(
        drive.xy_m[step],
        drive.yaw_rad[step],
        drive.xy_m[step + 1],
        drive.yaw_rad[step + 1],
        np.broadcast_to(others.size_m[target], (len(row), 2)),
    )
    return own, Sweep.of(others, row, step)


def is_behind(
    other_xy_m: FloatArray, xy_m: FloatArray, yaw_rad: FloatArray, length_m: FloatArray | float
) -> BoolArray:
    """Return (…,) whether centres (…, 2) are behind the rears of boxes at (…, 2), (…,); False for who is not there."""
    along = ((other_xy_m - xy_m) * unit(yaw_rad)).sum(-1)
    return np.asarray(along < -0.5 * length_m)


def _closing_mps(a: Sweep, b: Sweep, pair: int, fraction: float, dt_s: float) -> float:
    """Return the speed at which the boxes of *pair* approach along their contact normal."""
    picked = np.array([pair])
    a, b = a.rows(picked), b.rows(picked)
    gaps, along, axes = gaps_at(a, b, fraction, fraction)
    best = int(np.argmax(gaps[0]))
    normal = np.copysign(1.0, along[0, best]) * axes[0, best]
    return max(0.0, float((a.move_m[0] - b.move_m[0]) @ normal) / dt_s)


def least_gap_m(drive: Trajectory, others: Tracks, target: int, partner: int, length: int) -> float:
    """Return the least distance between the drive's box and that of *partner* over the first *length* instants."""
    at = slice(0, length)
    own = corners(drive.xy_m[at], drive.yaw_rad[at], np.broadcast_to(others.size_m[target], (length, 2)))
    size = np.broadcast_to(others.size_m[partner], (length, 2))
    gap = distance(own, corners(others.xy_m[partner, at], others.yaw_rad[partner, at], size))
    return float(np.nanmin(gap)) if np.isfinite(gap).any() else float("inf")
