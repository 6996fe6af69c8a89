"""What a driver in the target's place has to do about others: the least braking that avoids a collision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import axis_gaps
from advdiff_sumo.metrics.reference.driver_models import HUMAN
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_DT_S, FINE_TIMES_S, speeds_along
from advdiff_sumo.traffic.manoeuvres.intensity import HARDEST_MPS2
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S, FINE_STEPS
from advdiff_sumo.traffic.manoeuvres.ways import Way

REACTION_S = HUMAN.delay_s
"""Delay of a careful and competent driver (UN Regulation No. 157, Annex 4, Appendix 3)."""
BRAKING_MPS2 = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
"""Decelerations that are tried, mildest first."""
INSUFFICIENT_MPS2 = 99.0
"""Stands for an encounter that none of them avoids."""
CLEARANCE_M = 0.3
"""Least room before and behind the target."""
EXPECTED_STOP_MPS2 = 4.5
"""Braking with which somebody is believed to stop at its line still; who finds it will not brakes its hardest."""
HURRYING_MPS2 = 2.0
"""How fast somebody gains speed who hurries to be past."""
_NOTICES_S = 0.25
_NEARLY_S = (-0.2, 0.0, 0.2)
DELAYS_S = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
"""By how much the target may be early or late."""


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

    @cached_property
    def free_speed_mps(self) -> FloatArray:
        """Its (121,) speeds at ``FINE_TIMES_S`` if it sees nobody."""
        return speeds_along(self.way, self.speed_mps)

    @cached_property
    def free_distance_m(self) -> FloatArray:
        """The (121,) distances driven meanwhile."""
        return _driven(self.free_speed_mps)

    def arrival_s(self, ahead_m: float) -> float:
        """Return when its centre is *ahead_m* further on if it sees nobody; inf where that is not within 6 s."""
        at = int(np.searchsorted(self.free_distance_m, ahead_m))
        return float(FINE_TIMES_S[at]) if at < len(FINE_TIMES_S) else np.inf

    def braked_motion(self, braking_mps2: Sequence[float], from_s: float) -> tuple[FloatArray, FloatArray]:
        """Return distances driven and speeds (P, T), at ``CHECK_TIMES_S``, with each braking *from_s* on; 0: none."""
        speed = self._braked_mps(braking_mps2, from_s)
        at = slice(FINE_STEPS, None, FINE_STEPS)
        return _driven(speed)[:, at], speed[:, at]

    def escape_distances_m(self, from_s: float) -> FloatArray:
        """Return (2, 121) distances driven at ``FINE_TIMES_S`` if it brakes in full, or hurries, *from_s* on."""
        hurries = self.free_speed_mps + HURRYING_MPS2 * np.maximum(FINE_TIMES_S - from_s, 0.0)
        return _driven(np.vstack((self._braked_mps((HARDEST_MPS2,), from_s), hurries)))

    def _braked_mps(self, braking_mps2: Sequence[float], from_s: float) -> FloatArray:
        then = float(np.interp(from_s, FINE_TIMES_S, self.free_speed_mps))
        braked = then - np.array(braking_mps2)[:, None] * (FINE_TIMES_S - from_s)
        bound = np.where((from_s >= FINE_TIMES_S) | (np.array(braking_mps2)[:, None] <= 0.0), np.inf, braked)
        return np.minimum(self.free_speed_mps, np.maximum(bound, 0.0))

    def braked_poses(self, perceived_s: float) -> tuple[FloatArray, FloatArray]:
        """Return centres (P, T, 2) and headings (P, T) of the target for every entry of ``BRAKING_MPS2``.

        It goes on until ``REACTION_S`` after it can perceive the other's intention, which is *perceived_s* from
        now; the first entry goes on for ever.
        """
        return self.way.poses(self.braked_motion(BRAKING_MPS2, perceived_s + REACTION_S)[0], CHECK_TIMES_S)


def _driven(speed_mps: FloatArray) -> FloatArray:
    """Return the distances (…, 121) of speeds at ``FINE_TIMES_S``."""
    stride = 0.5 * FINE_DT_S * (speed_mps[..., 1:] + speed_mps[..., :-1])
    return np.concatenate((np.zeros_like(speed_mps[..., :1]), np.cumsum(stride, axis=-1)), axis=-1)


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
        clear = _clear(target, target.braked_poses(when), xy_m[rows], yaw_rad[rows], size_m[rows])
        mildest = np.array(BRAKING_MPS2)[clear.argmax(axis=1)]
        out[rows] = np.where(clear.any(axis=1), mildest, INSUFFICIENT_MPS2)
    return out


def contact_share(target: TargetWay, xy_m: FloatArray, yaw_rad: FloatArray, size_m: FloatArray) -> FloatArray:
    """Return (C,) in which share of ``DELAYS_S`` a target that goes on would touch each future, were it so late there.

    A contact that needs no timing survives that the target drives a little otherwise than expected; arguments as in
    :func:`needed_braking`.
    """
    poses = target.way.poses(_late_m(target.free_distance_m, DELAYS_S), CHECK_TIMES_S)
    return np.asarray(1.0 - _clear(target, poses, xy_m, yaw_rad, size_m).mean(axis=1))


def trapped_share(
    target: TargetWay, xy_m: FloatArray, yaw_rad: FloatArray, size_m: FloatArray, notices_s: FloatArray
) -> FloatArray:
    """Return (C,) in which share of times neither full braking nor hurrying keeps the target clear of each future.

    Args:
        target: the tested vehicle; it goes on until it notices, and is up to 0.2 s early or late.
        xy_m: (C, T, 2) centres of the other vehicle at ``CHECK_TIMES_S``, one future each.
        yaw_rad: (C, T) its headings.
        size_m: (C, 2) its length and width.
        notices_s: (C,) when it notices each; one that has noticed already brakes.
    """
    out = np.zeros(len(xy_m))
    for when in np.unique(notices_s[np.isfinite(notices_s)]).tolist():
        rows = notices_s == when
        touches = [
            ~_clear(
                target,
                target.way.poses(_late_m(driven_m, _NEARLY_S), CHECK_TIMES_S),
                xy_m[rows],
                yaw_rad[rows],
                size_m[rows],
                -CLEARANCE_M,
            )
            for driven_m in target.escape_distances_m(when)[: 2 if when > 0.0 else 1]
        ]
        out[rows] = np.all(touches, axis=0).mean(axis=1)
    return out


def _late_m(driven_m: FloatArray, late_s: Sequence[float]) -> FloatArray:
    """Return (L, T) distances at ``CHECK_TIMES_S`` of *driven_m* (121,), earlier or later by *late_s* (L,)."""
    times = np.maximum(FINE_TIMES_S[:, None] + np.array(late_s), 0.0)
    return np.asarray(np.interp(times, FINE_TIMES_S, driven_m).T[:, FINE_STEPS::FINE_STEPS])


def notices_no_stop_s(to_line_m: float, now_mps: float, driven_m: FloatArray, speed_mps: FloatArray) -> float:
    """Return when a target that believes the other to have a red light brakes for it after all.

    That is ``_NOTICES_S`` after the other can no longer stop at its line with ``BELIEVED_MPS2``; now, if it cannot.

    Args:
        to_line_m: distance of the other's front to its stop line now.
        now_mps: its speed now.
        driven_m: (T,) distances that it drives by ``CHECK_TIMES_S``.
        speed_mps: (T,) its speeds.
    """
    if now_mps**2 > 2.0 * EXPECTED_STOP_MPS2 * max(to_line_m, 0.0):
        return 0.0
    goes = speed_mps**2 > 2.0 * EXPECTED_STOP_MPS2 * np.maximum(to_line_m - driven_m, 0.0)
    return float(CHECK_TIMES_S[int(goes.argmax())]) + _NOTICES_S if goes.any() else np.inf


def _clear(
    target: TargetWay,
    answers: tuple[FloatArray, FloatArray],
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    size_m: FloatArray,
    room_m: float = CLEARANCE_M,
) -> BoolArray:
    """Return (C, P) which answers of the target stay clear of which future, by *room_m* before and behind it."""
    half = 0.5 * target.size_m + room_m * np.array([1.0, 0.0])
    own, theirs = np.broadcast_arrays(answers[1][None], yaw_rad[:, None])
    offset = xy_m[:, None] - answers[0][None]
    gaps = axis_gaps(offset, own, half, theirs, 0.5 * size_m[:, None, None])[0].max(-1)
    return np.asarray((gaps > 0.0).all(axis=-1))
