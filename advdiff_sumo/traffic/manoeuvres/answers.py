"""What a driver in the target's place has to do about others: the least braking that avoids contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.traffic.manoeuvres.profiles import CHECK_TIMES_S, SpeedProfile, drive_profiles
from advdiff_sumo.traffic.manoeuvres.ways import Way

REACTION_S = 0.75
"""Delay of a careful and competent driver (UN Regulation No. 157, Annex 4, Appendix 3)."""
BRAKING_MPS2 = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
"""Decelerations that are tried, mildest first."""
UNANSWERABLE_MPS2 = 99.0
"""Stands for an encounter that none of them avoids."""
_GOES_ON_MPS2 = 0.5
_ROOM_M = 0.3


@dataclass(frozen=True)
class TargetWay:
    """The target as its opponents see it: it follows its way and chooses its speed.

    Attributes:
        way: what it follows.
        speed_mps: now.
        size_m: (2,) length and width.
    """

    way: Way
    speed_mps: float
    size_m: FloatArray

    def answers(self, perceived_s: float) -> tuple[FloatArray, FloatArray]:
        """Return centres (P, T, 2) and headings (P, T) of the target for every entry of ``BRAKING_MPS2``.

        It goes on until ``REACTION_S`` after it can perceive the other's intention, which is *perceived_s* from
        now; the first entry goes on for ever, towards the limit.
        """
        limit = max(self.way.lane.speed_mps, self.speed_mps)
        brakes_s = perceived_s + REACTION_S
        profiles = [
            SpeedProfile(_GOES_ON_MPS2, brakes_s if brake else np.inf, -brake, highest_mps=limit)
            for brake in BRAKING_MPS2
        ]
        driven, _ = drive_profiles(np.full(len(profiles), self.speed_mps), profiles)
        return self.way.poses(driven, CHECK_TIMES_S)


def needed_braking(
    target: TargetWay, xy_m: FloatArray, yaw_rad: FloatArray, size_m: FloatArray, perceived_s: FloatArray
) -> FloatArray:
    """Return (C,) the mildest of ``BRAKING_MPS2`` that keeps the target clear of each future.

    Args:
        target: the tested vehicle.
        xy_m: (C, T, 2) centres of the other vehicle at ``CHECK_TIMES_S``, one future each.
        yaw_rad: (C, T) its headings.
        size_m: (C, 2) its length and width.
        perceived_s: (C,) when the target can perceive what the other is up to.

    Returns:
        0 where no braking is needed, ``UNANSWERABLE_MPS2`` where none of them is enough.
    """
    out = np.empty(len(perceived_s))
    for when in np.unique(perceived_s).tolist():
        rows = perceived_s == when
        clear = _clear(target, target.answers(when), xy_m[rows], yaw_rad[rows], size_m[rows])
        mildest = np.array(BRAKING_MPS2)[clear.argmax(axis=1)]
        out[rows] = np.where(clear.any(axis=1), mildest, UNANSWERABLE_MPS2)
    return out


def _clear(
    target: TargetWay,
    answers: tuple[FloatArray, FloatArray],
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    size_m: FloatArray,
) -> BoolArray:
    """Return (C, P) which answers of the target stay clear of which future."""
    half = 0.5 * target.size_m + _ROOM_M * np.array([1.0, 0.0])
    own, theirs = np.broadcast_arrays(answers[1][None], yaw_rad[:, None])
    offset = xy_m[:, None] - answers[0][None]
    gaps = axis_gaps(offset, own, half, theirs, 0.5 * size_m[:, None, None])[0].max(-1)
    return np.asarray((gaps > 0.0).all(axis=-1))
