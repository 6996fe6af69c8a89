"""The target's first contact within one step: the check that the simulation makes every 0.1 s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import axis_gaps, corners
from advdiff_sumo.metrics.sweep import TOUCH_M, Sweep, first_contact

#: Faster than this between two instants is a jump (an insertion, a teleport): nothing is swept over it.
JUMP_MPS = 100.0
#: A contact lasts until the boxes are this far apart; a closer rebound is the same collision.
SEPARATED_M = 0.1
#: Both boxes are grown by this to give their first touch an area, whose centroid is the impact point.
_TOUCH_MARGIN_M = 0.01
_DEPTH_SAMPLES = 9


@dataclass(frozen=True)
class Contact:
    """A first touch of two boxes within a step.

    Attributes:
        row: row of the partner.
        fraction: when, as a share of the step in [0, 1).
        point_m: (2,) centroid of the contact region, world frame.
        penetration_m: deepest overlap from the touch to the end of the step (the least translation that
            parts the boxes).
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

    Absent vehicles hold NaN at either instant and cannot touch. A vehicle that jumps (``JUMP_MPS``) is not
    swept; of contacts at the same moment the lowest row is returned.

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
    rows = np.flatnonzero(near)
    if not rows.size:
        return None
    sweep = Sweep.between(xy0_m, yaw0_rad, xy1_m, yaw1_rad, size_m)
    target = sweep.rows(np.full(rows.size, target_row))
    fractions = first_contact(target, sweep.rows(rows))
    if np.isnan(fractions).all():
        return None
    first = int(np.nanargmin(fractions))
    pair = target.rows(np.array([first])), sweep.rows(rows[[first]])
    return contact_of(*pair, float(fractions[first]), int(rows[first]))


def contact_of(a: Sweep, b: Sweep, fraction: float, row: int) -> Contact:
    """Return the contact of the single pair a, b (K = 1) that first touches at *fraction*."""
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
    """Return (N,) contacts with the target that were there when the vehicle appeared and still last.

    They come from logs and insertions, not from driving, and are no failure of the target. Call it with
    *before* None and the same instant twice at the start, then once a step after :func:`target_contact`,
    whose ``ignore`` it makes. A vehicle appears where *xy0_m* is NaN or when it jumps.

    Args:
        before: the last result, or None at the start.
        xy0_m: (N, 2) box centres at the previous instant.
        xy1_m: (N, 2) box centres now.
        yaw1_rad: (N,) headings now.
        size_m: (N, 2) length and width.
        target_row: row of the tested vehicle.
        dt_s: time between the instants.
    """
    half = 0.5 * size_m
    gaps, _, _ = axis_gaps(
        xy1_m - xy1_m[target_row],
        np.broadcast_to(yaw1_rad[target_row], yaw1_rad.shape),
        half[target_row],
        yaw1_rad,
        half,
    )
    gap = gaps.max(-1)
    kept = ~(np.hypot(*(xy1_m - xy0_m).T) <= JUMP_MPS * dt_s)
    kept |= kept[target_row]
    started = (gap <= TOUCH_M) & (kept if before is not None else True)
    lasting = (gap <= SEPARATED_M) & before if before is not None else np.zeros_like(started)
    result = np.asarray(started | lasting)
    result[target_row] = False
    return result


def _near(
    xy0_m: FloatArray, xy1_m: FloatArray, size_m: FloatArray, target_row: int, jump_m: float
) -> BoolArray:
    """Return (N,) rows whose circle may meet the target's within the step; never False for a contact."""
    move = xy1_m - xy0_m
    half_move = 0.5 * (move - move[target_row])
    middle = xy0_m - xy0_m[target_row] + half_move
    radius = 0.5 * np.sqrt(np.einsum("nc,nc->n", size_m, size_m))
    reach = radius + (radius[target_row] + TOUCH_M)
    distance = np.sqrt(np.einsum("nc,nc->n", middle, middle))
    swept = np.sqrt(np.einsum("nc,nc->n", half_move, half_move))
    near = distance - swept <= reach
    near[target_row] = False
    if near.any():
        near &= np.hypot(move[:, 0], move[:, 1]) <= jump_m
        near &= bool(np.hypot(*move[target_row]) <= jump_m)
    return np.asarray(near)


def _touch_point(a: Sweep, b: Sweep, fraction: float) -> FloatArray:
    region = shapely.intersection(_grown(a, fraction), _grown(b, fraction))
    point = region.centroid
    return np.array((point.x, point.y))


def _depth(a: Sweep, b: Sweep, fraction: float) -> float:
    share = np.linspace(fraction, 1.0, _DEPTH_SAMPLES)
    rows = np.zeros(_DEPTH_SAMPLES, dtype=np.int64)
    a, b = a.rows(rows), b.rows(rows)
    (xy_a, yaw_a), (xy_b, yaw_b) = a.pose(share), b.pose(share)
    gaps, _, _ = axis_gaps(xy_b - xy_a, yaw_a, a.half_m, yaw_b, b.half_m)
    return float(max(0.0, -gaps.max(-1).min()))


def _grown(box: Sweep, fraction: float) -> shapely.Polygon:
    return shapely.Polygon(corners(*box.pose(fraction), 2.0 * (box.half_m + _TOUCH_MARGIN_M))[0])
