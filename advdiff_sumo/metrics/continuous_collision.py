"""Find when two moving boxes first touch within one step, by conservative advancement, for arrays of pairs.

Between two instants the centre of a box moves on a straight line and the box turns evenly along the shorter arc. Along
a fixed separating axis, the gap of two boxes shrinks at most at their closing speed plus the speed of their corners
from turning. Time may therefore advance by the gap divided by this rate without missing a contact (after Mirtich 1996,
"Impulse-based dynamic simulation of rigid body systems", ch. 2). Without turning, the first contact is exact after at
most four advances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import Tracks

#: Boxes nearer than this touch.
TOUCH_M = 1e-6
#: Smallest advance as a share of the step (0.1 ms of 0.1 s). It bounds both the computing time and the error.
LEAST_ADVANCE = 1e-3


@dataclass(frozen=True)
class BoxMotion:
    """One step of K boxes.

    Attributes:
        xy_m: (K, 2) centres at the start.
        yaw_rad: (K,) headings at the start.
        move_m: (K, 2) displacements of the centres.
        turn_rad: (K,) signed turns, along the shorter arc.
        half_m: (K, 2) half length and half width.
    """

    xy_m: FloatArray
    yaw_rad: FloatArray
    move_m: FloatArray
    turn_rad: FloatArray
    half_m: FloatArray

    @staticmethod
    def between(
        xy0_m: FloatArray, yaw0_rad: FloatArray, xy1_m: FloatArray, yaw1_rad: FloatArray, size_m: FloatArray
    ) -> BoxMotion:
        """Return the step from the first poses to the second ones; *size_m* is (K, 2) length and width."""
        return BoxMotion(xy0_m, yaw0_rad, xy1_m - xy0_m, wrap_angle(yaw1_rad - yaw0_rad), 0.5 * size_m)

    @staticmethod
    def of(tracks: Tracks, row: IntArray, step: IntArray) -> BoxMotion:
        """Return the steps of agents *row* (K,) of *tracks* from instants *step* (K,) to the next ones."""
        begin, end = (row, step), (row, step + 1)
        return BoxMotion.between(
            tracks.xy_m[begin],
            tracks.yaw_rad[begin],
            tracks.xy_m[end],
            tracks.yaw_rad[end],
            tracks.size_m[row],
        )

    def rows(self, rows: IntArray | BoolArray) -> BoxMotion:
        """Return the boxes at *rows* (indices or a mask)."""
        return BoxMotion(
            self.xy_m[rows], self.yaw_rad[rows], self.move_m[rows], self.turn_rad[rows], self.half_m[rows]
        )

    def pose(self, fraction: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Return centres (K, 2) and headings (K,) at *fraction* (K,) of the step."""
        share = np.asarray(fraction, dtype=np.float64)
        return self.xy_m + share[..., None] * self.move_m, self.yaw_rad + share * self.turn_rad


def gaps_at(
    a: BoxMotion, b: BoxMotion, share_a: FloatArray | float, share_b: FloatArray | float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the result of ``boxes.axis_gaps`` for boxes a and b at these shares (K,) of their steps."""
    (xy_a, yaw_a), (xy_b, yaw_b) = a.pose(share_a), b.pose(share_b)
    return axis_gaps(xy_b - xy_a, yaw_a, a.half_m, yaw_b, b.half_m)


def may_touch(a: BoxMotion, b: BoxMotion) -> BoolArray:
    """Return (K,) whether the circles around the boxes come near enough for a contact; False for NaN.

    Never False for a pair that touches. The offset between the centres moves on a segment. Its length is at least that
    at the segment's middle minus half the segment's length.
    """
    half_move = 0.5 * (b.move_m - a.move_m)
    middle = b.xy_m - a.xy_m + half_move
    reach = _norm(a.half_m) + _norm(b.half_m) + TOUCH_M
    return np.asarray(_norm(middle) - _norm(half_move) <= reach)


def first_contact(a: BoxMotion, b: BoxMotion) -> FloatArray:
    """Return (K,) the share of the step in [0, 1) at which boxes a and b first touch; NaN where they do not.

    A contact that begins exactly at the end belongs to the next step. Only contacts shorter than ``LEAST_ADVANCE`` of
    the step may be missed. Rows that hold NaN give NaN.
    """
    fraction = np.zeros(len(a.yaw_rad))
    hit = np.zeros(len(a.yaw_rad), dtype=np.bool_)
    active = np.flatnonzero(may_touch(a, b))
    while active.size:
        gap, advance = _advance(a.rows(active), b.rows(active), fraction[active])
        touching = gap <= TOUCH_M
        hit[active[touching]] = True
        later = fraction[active] + np.maximum(advance, LEAST_ADVANCE)
        continues = ~touching & (later < 1.0)
        active = active[continues]
        fraction[active] = later[continues]
    return np.where(hit, fraction, np.nan)


def _advance(a: BoxMotion, b: BoxMotion, fraction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the gaps (K,) at *fraction* (K,) and the share of the step by which time may safely advance."""
    gaps, along, axes = gaps_at(a, b, fraction, fraction)
    closing = -np.sign(along) * np.einsum("kic,kc->ki", axes, b.move_m - a.move_m)
    corner_move = np.abs(a.turn_rad) * _norm(a.half_m) + np.abs(b.turn_rad) * _norm(b.half_m)
    rate = np.maximum(closing + corner_move[:, None], 1e-12)  # m per step
    return gaps.max(-1), (np.maximum(gaps, 0.0) / rate).max(-1)


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(vectors[..., 0], vectors[..., 1]))
