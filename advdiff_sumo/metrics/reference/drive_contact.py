"""Find the collisions of a drive with recorded road users, and the least gap to one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import corners, distance
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.continuous_collision import BoxMotion, first_contact, gaps_at
from advdiff_sumo.metrics.target_contact import JUMP_MPS


@dataclass(frozen=True)
class Touch:
    """The first contact of a drive with one of the others.

    Attributes:
        step: instant before the contact, in the record's count.
        name: id of the other.
        closing_mps: speed at which the boxes approach along their contact normal.
        from_behind: whether the other's centre is behind the drive's rear at that instant.
        from_start: whether the two overlapped already when the drive began.
    """

    step: int
    name: str
    closing_mps: float
    from_behind: bool
    from_start: bool = False


def touches(drive: Trajectory, others: Tracks, target: int, first_step: int) -> tuple[Touch, ...]:
    """Return the first contact with each of *others* that the drive collides with, in the order of time.

    Args:
        drive: (T,) states.
        others: all road users at the same T instants, the target included.
        target: row of the target.
        first_step: index of the first instant in the record.
    """
    row, step = _within_reach(drive, others, target)
    if not row.size:
        return ()
    own, other = _sweeps(drive, others, target, row, step)
    fraction = first_contact(own, other)
    touching = np.flatnonzero(np.isfinite(fraction))
    by_time = touching[np.argsort((step + fraction)[touching], kind="stable")]
    _, first_of_row = np.unique(row[by_time], return_index=True)
    behind = is_behind(others.xy_m, drive.xy_m, drive.yaw_rad, others.size_m[target, 0])
    return tuple(
        Touch(
            first_step + int(step[pair]),
            others.ids[row[pair]],
            _closing_mps(own, other, pair, float(fraction[pair]), others.dt_s),
            bool(behind[row[pair], step[pair]]),
            bool(step[pair] + fraction[pair] == 0.0),
        )
        for pair in by_time[np.sort(first_of_row)].tolist()
    )


def _within_reach(drive: Trajectory, others: Tracks, target: int) -> tuple[IntArray, IntArray]:
    """Return rows and instants of others so near that they might touch the drive before the next instant.

    Jumps are left out, as in :func:`~advdiff_sumo.metrics.target_contact.target_contact`.
    """
    size = others.size_m
    offset = others.xy_m[:, :-1] - drive.xy_m[:-1]
    move = np.hypot(*np.moveaxis(np.diff(others.xy_m, axis=1), -1, 0))
    own_move = np.hypot(*np.diff(drive.xy_m, axis=0).T)
    reach = 0.5 * (np.hypot(*size.T) + np.hypot(*size[target]))[:, None] + move + own_move
    with np.errstate(invalid="ignore"):
        near = (np.hypot(offset[..., 0], offset[..., 1]) <= reach) & (move <= JUMP_MPS * others.dt_s)
    near[target] = False
    row, step = np.nonzero(near)
    return row, step


def _sweeps(
    drive: Trajectory, others: Tracks, target: int, row: IntArray, step: IntArray
) -> tuple[BoxMotion, BoxMotion]:
    """Return the motion of the drive and of the others in *row* from instants *step* to the next ones."""
    own = BoxMotion.between(
        drive.xy_m[step],
        drive.yaw_rad[step],
        drive.xy_m[step + 1],
        drive.yaw_rad[step + 1],
        np.broadcast_to(others.size_m[target], (len(row), 2)),
    )
    return own, BoxMotion.of(others, row, step)


def is_behind(
    other_xy_m: FloatArray, xy_m: FloatArray, yaw_rad: FloatArray, length_m: FloatArray | float
) -> BoolArray:
    """Return (…,) whether centres (…, 2) are behind the rears of boxes at (…, 2), (…,); False for absent ones."""
    along = ((other_xy_m - xy_m) * unit(yaw_rad)).sum(-1)
    return np.asarray(along < -0.5 * length_m)


def _closing_mps(a: BoxMotion, b: BoxMotion, pair: int, fraction: float, dt_s: float) -> float:
    """Return the speed at which the boxes of *pair* approach along their contact normal."""
    index = np.array([pair])
    a, b = a.rows(index), b.rows(index)
    gaps, along, axes = gaps_at(a, b, fraction, fraction)
    axis = int(np.argmax(gaps[0]))
    normal = np.copysign(1.0, along[0, axis]) * axes[0, axis]
    return max(0.0, float((a.move_m[0] - b.move_m[0]) @ normal) / dt_s)


def least_gap_m(drive: Trajectory, others: Tracks, target: int, partner: int, length: int) -> float:
    """Return the least distance between the drive's box and that of *partner* over the first *length* instants."""
    part = slice(0, length)
    own_size = np.broadcast_to(others.size_m[target], (length, 2))
    own = corners(drive.xy_m[part], drive.yaw_rad[part], own_size)
    size = np.broadcast_to(others.size_m[partner], (length, 2))
    gap = distance(own, corners(others.xy_m[partner, part], others.yaw_rad[partner, part], size))
    return float(np.nanmin(gap)) if np.isfinite(gap).any() else float("inf")
