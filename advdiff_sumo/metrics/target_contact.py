"""Detect the target's first contact within one step, as the simulation does every 0.1 s."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import shapely

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import axis_gaps, corners
from advdiff_sumo.metrics.continuous_collision import TOUCH_M, BoxMotion, first_contact, gaps_at

#: Faster motion between two instants is a jump (an insertion, a teleport), in which no contact is searched.
JUMP_MPS = 100.0
#: A contact lasts until the boxes are this far apart; touching again before is the same collision.
SEPARATED_M = 0.1
#: Both boxes are grown by this so that their first touch has an area, whose centroid is the impact point.
_TOUCH_MARGIN_M = 0.01
#: Times at which the depth of the overlap is sampled, from the contact to the end of the step.
_DEPTH_SAMPLES = 9

#: x, y, displacement x and y, cos and sin of the heading, half length and width, path of the corners by turning.
_Scalars: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True)
class Contact:
    """The first contact of two boxes within a step.

    Attributes:
        row: row of the partner.
        fraction: share of the step until the contact, in [0, 1).
        point_m: (2,) centroid of the contact region, world frame.
        penetration_m: deepest overlap from the contact to the end of the step (the least translation that separates
            the boxes).
    """

    row: int
    fraction: float
    point_m: FloatArray
    penetration_m: float


def target_contact(
    xy0_m: FloatArray,
    yaw0_rad: FloatArray,
    xy1_m: FloatArray,
    yaw1_rad: FloatArray,
    size_m: FloatArray,
    target_row: int,
    *,
    ignore: BoolArray | None = None,
    dt_s: float = 0.1,
) -> Contact | None:
    """Return the target's first contact between two successive instants, or None.

    Absent vehicles hold NaN at either instant and cannot collide. Neither can a vehicle that jumps (``JUMP_MPS``). Of
    contacts at the same time the one with the lowest row is returned.

    Args:
        xy0_m: (N, 2) box centres at the first instant.
        yaw0_rad: (N,) headings.
        xy1_m: (N, 2) box centres at the second instant.
        yaw1_rad: (N,) headings.
        size_m: (N, 2) length and width.
        target_row: row of the tested vehicle.
        ignore: (N,) rows that do not count, such as those of :func:`standing_overlaps`.
        dt_s: time between the instants.
    """
    near = _near(xy0_m, xy1_m, size_m, target_row, JUMP_MPS * dt_s)
    if ignore is not None:
        near &= ~ignore
    near_rows = np.flatnonzero(near)
    if not near_rows.size:
        return None
    poses = xy0_m, yaw0_rad, xy1_m, yaw1_rad, 0.5 * size_m
    own, *others = (_scalars(*(p[row] for p in poses)) for row in (target_row, *near_rows))
    rows = near_rows[[not _are_separate(own, other) for other in others]]
    if not rows.size:
        return None
    motion = BoxMotion.between(xy0_m, yaw0_rad, xy1_m, yaw1_rad, size_m)
    target = motion.rows(np.full(rows.size, target_row))
    fractions = first_contact(target, motion.rows(rows))
    if np.isnan(fractions).all():
        return None
    first = int(np.nanargmin(fractions))
    pair = target.rows(np.array([first])), motion.rows(rows[[first]])
    return contact_of(*pair, float(fractions[first]), int(rows[first]))


def contact_of(a: BoxMotion, b: BoxMotion, fraction: float, row: int) -> Contact:
    """Return the contact of the single pair a, b (K = 1) that first touches at *fraction*; *row* is that of b."""
    return Contact(row, fraction, _touch_point(a, b, fraction), _depth(a, b, fraction))


def standing_overlaps(
    before: BoolArray | None,
    xy0_m: FloatArray,
    xy1_m: FloatArray,
    yaw1_rad: FloatArray,
    size_m: FloatArray,
    target_row: int,
    *,
    dt_s: float = 0.1,
) -> BoolArray:
    """Return (N,) whether a vehicle overlapped the target when it appeared and has done so ever since.

    Such overlaps come from logs and insertions, not from driving, and are no failure of the target. At the start, call
    it with *before* None and the same instant twice. Then call it once per step after :func:`target_contact`; the
    result is the ``ignore`` of the next step. A vehicle appears where *xy0_m* is NaN or when it jumps.

    Args:
        before: the last result, or None at the start.
        xy0_m: (N, 2) box centres at the previous instant.
        xy1_m: (N, 2) box centres now.
        yaw1_rad: (N,) headings now.
        size_m: (N, 2) length and width.
        target_row: row of the tested vehicle.
        dt_s: time between the instants.
    """
    move = xy1_m - xy0_m
    moves_on = np.hypot(move[:, 0], move[:, 1]) <= JUMP_MPS * dt_s
    appeared = ~(moves_on & moves_on[target_row]) if before is not None else np.ones_like(moves_on)
    candidates = appeared if before is None else appeared | before
    result = np.zeros_like(candidates)
    rows = np.flatnonzero(candidates)
    if rows.size:
        gap = _gaps_to(target_row, rows, xy1_m, yaw1_rad, 0.5 * size_m)
        result[rows] = gap <= np.where(appeared[rows], TOUCH_M, SEPARATED_M)
    result[target_row] = False
    return result


def _gaps_to(
    target_row: int, rows: IntArray, xy_m: FloatArray, yaw_rad: FloatArray, half_m: FloatArray
) -> FloatArray:
    own = np.full(rows.size, target_row)
    gaps, _, _ = axis_gaps(xy_m[rows] - xy_m[own], yaw_rad[own], half_m[own], yaw_rad[rows], half_m[rows])
    return np.asarray(gaps.max(-1))


def _near(
    xy0_m: FloatArray, xy1_m: FloatArray, size_m: FloatArray, target_row: int, jump_m: float
) -> BoolArray:
    """Return (N,) whether the circle around a box may meet the target's within the step; never False for a contact."""
    move = xy1_m - xy0_m
    half_move = 0.5 * (move - move[target_row])
    middle = xy0_m - xy0_m[target_row] + half_move
    reach = 0.5 * np.hypot(size_m[:, 0], size_m[:, 1])
    reach += reach[target_row] + TOUCH_M
    near = np.hypot(middle[:, 0], middle[:, 1]) - np.hypot(half_move[:, 0], half_move[:, 1]) <= reach
    near[target_row] = False
    if near.any():
        near &= np.hypot(move[:, 0], move[:, 1]) <= jump_m
        near &= bool(np.hypot(*move[target_row]) <= jump_m)
    return np.asarray(near)


def _scalars(xy0: FloatArray, yaw0: float, xy1: FloatArray, yaw1: float, half: FloatArray) -> _Scalars:
    (x, y), (x1, y1), (length, width) = xy0.tolist(), xy1.tolist(), half.tolist()
    turn = abs(math.remainder(yaw1 - yaw0, math.tau)) * math.hypot(length, width)
    return x, y, x1 - x, y1 - y, math.cos(yaw0), math.sin(yaw0), length, width, turn


def _are_separate(a: _Scalars, b: _Scalars) -> bool:
    """Return whether one axis separates the boxes throughout the step.

    This is the first advance of :func:`.first_contact` in scalars. Circles of queues beside the target meet at every
    step, and arrays would be ten times slower here.
    """
    dx, dy, vx, vy = b[0] - a[0], b[1] - a[1], b[2] - a[2], b[3] - a[3]
    same, cross = abs(a[4] * b[4] + a[5] * b[5]), abs(a[4] * b[5] - a[5] * b[4])
    turn = a[8] + b[8] + TOUCH_M
    for box, other in ((a, b), (b, a)):
        _, _, _, _, cos, sin, length, width, _ = box
        reach_along = other[6] * same + other[7] * cross + length
        reach_across = other[6] * cross + other[7] * same + width
        for nx, ny, reach in ((cos, sin, reach_along), (-sin, cos, reach_across)):
            offset = dx * nx + dy * ny
            closing = -math.copysign(1.0, offset) * (vx * nx + vy * ny)
            if abs(offset) - reach > max(closing + turn, TOUCH_M):
                return True
    return False


def _touch_point(a: BoxMotion, b: BoxMotion, fraction: float) -> FloatArray:
    region = shapely.intersection(_grown_box(a, fraction), _grown_box(b, fraction))
    point = region.centroid
    return np.array((point.x, point.y))


def _depth(a: BoxMotion, b: BoxMotion, fraction: float) -> float:
    """Return the deepest overlap in m from *fraction* to the end of the step."""
    share = np.linspace(fraction, 1.0, _DEPTH_SAMPLES)
    rows = np.zeros(_DEPTH_SAMPLES, dtype=np.int64)
    a, b = a.rows(rows), b.rows(rows)
    gaps, _, _ = gaps_at(a, b, share, share)
    return float(max(0.0, -gaps.max(-1).min()))


def _grown_box(box: BoxMotion, fraction: float) -> shapely.Polygon:
    return shapely.Polygon(corners(*box.pose(fraction), 2.0 * (box.half_m + _TOUCH_MARGIN_M))[0])
