"""What a driver in the target's place must do about another vehicle: the least braking that avoids a collision."""

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
"""Decelerations of the target that are tried, mildest first."""
INSUFFICIENT_MPS2 = 99.0
"""Required deceleration of an encounter that none of ``BRAKING_MPS2`` avoids."""
CLEARANCE_M = 0.3
"""Least distance before and behind the target."""
EXPECTED_STOP_MPS2 = 4.5
"""The target expects a vehicle to stop at its line while this deceleration suffices."""
HURRYING_MPS2 = 2.0
"""Acceleration of a vehicle that hurries to pass before another one."""
_NOTICE_DELAY_S = 0.25  # from when a vehicle can no longer stop at its line until the target notices it
_SMALL_SHIFTS_S = (-0.2, 0.0, 0.2)
TIME_SHIFTS_S = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
"""By how much the target may be ahead of its free motion; behind it if negative."""


@dataclass(frozen=True)
class TargetWay:
    """The target as the attackers model it: it follows its way and only its speed varies.

    Attributes:
        way: the way that it follows.
        speed_mps: present speed.
        size_m: (2,) length and width.
    """

    way: Way
    speed_mps: float
    size_m: FloatArray

    @cached_property
    def free_speed_mps(self) -> FloatArray:
        """Its (121,) speeds at ``FINE_TIMES_S`` if it responds to no other road user."""
        return speeds_along(self.way, self.speed_mps)

    @cached_property
    def free_distance_m(self) -> FloatArray:
        """The (121,) distances that it then drives."""
        return _distances_m(self.free_speed_mps)

    def arrival_s(self, ahead_m: float) -> float:
        """Return when its centre is *ahead_m* further on if it responds to nobody; inf if not within 6 s."""
        at = int(np.searchsorted(self.free_distance_m, ahead_m))
        return float(FINE_TIMES_S[at]) if at < len(FINE_TIMES_S) else np.inf

    def braked_motion(self, braking_mps2: Sequence[float], from_s: float) -> tuple[FloatArray, FloatArray]:
        """Return distances and speeds (P, T) at ``CHECK_TIMES_S`` for P decelerations from *from_s* on; 0: none."""
        speed = self._braked_mps(braking_mps2, from_s)
        at_checks = slice(FINE_STEPS, None, FINE_STEPS)
        return _distances_m(speed)[:, at_checks], speed[:, at_checks]

    def escape_distances_m(self, from_s: float) -> FloatArray:
        """Return (2, 121) distances at ``FINE_TIMES_S`` if it brakes fully, or hurries, from *from_s* on."""
        hurrying = self.free_speed_mps + HURRYING_MPS2 * np.maximum(FINE_TIMES_S - from_s, 0.0)
        return _distances_m(np.vstack((self._braked_mps((HARDEST_MPS2,), from_s), hurrying)))

    def _braked_mps(self, braking_mps2: Sequence[float], from_s: float) -> FloatArray:
        start_mps = float(np.interp(from_s, FINE_TIMES_S, self.free_speed_mps))
        braked = start_mps - np.array(braking_mps2)[:, None] * (FINE_TIMES_S - from_s)
        is_unbraked = (from_s >= FINE_TIMES_S) | (np.array(braking_mps2)[:, None] <= 0.0)
        bound = np.where(is_unbraked, np.inf, braked)
        return np.minimum(self.free_speed_mps, np.maximum(bound, 0.0))

    def braked_poses(self, perceived_s: float) -> tuple[FloatArray, FloatArray]:
        """Return centres (P, T, 2) and headings (P, T) of the target for each of ``BRAKING_MPS2``.

        It brakes from ``REACTION_S`` after *perceived_s* on, when it can perceive the other vehicle's intention.
        """
        return self.way.poses(self.braked_motion(BRAKING_MPS2, perceived_s + REACTION_S)[0], CHECK_TIMES_S)


def _distances_m(speed_mps: FloatArray) -> FloatArray:
    """Return the distances (…, 121) that follow from speeds (…, 121) at ``FINE_TIMES_S``."""
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
        perceived_s: (C,) when the target can perceive the other vehicle's intention.

    Returns:
        0 where no braking is needed, ``INSUFFICIENT_MPS2`` where none of them is enough.
    """
    needed = np.empty(len(perceived_s))
    for time_s in np.unique(perceived_s).tolist():
        rows = perceived_s == time_s
        clear = _is_clear(target, target.braked_poses(time_s), xy_m[rows], yaw_rad[rows], size_m[rows])
        mildest = np.array(BRAKING_MPS2)[clear.argmax(axis=1)]
        needed[rows] = np.where(clear.any(axis=1), mildest, INSUFFICIENT_MPS2)
    return needed


def contact_share(target: TargetWay, xy_m: FloatArray, yaw_rad: FloatArray, size_m: FloatArray) -> FloatArray:
    """Return (C,) for which share of ``TIME_SHIFTS_S`` a target that does not respond would collide in each future.

    A high share means that the collision does not depend on exact timing. Arguments as in :func:`needed_braking`.
    """
    poses = target.way.poses(_shifted_m(target.free_distance_m, TIME_SHIFTS_S), CHECK_TIMES_S)
    return np.asarray(1.0 - _is_clear(target, poses, xy_m, yaw_rad, size_m).mean(axis=1))


def trapped_share(
    target: TargetWay, xy_m: FloatArray, yaw_rad: FloatArray, size_m: FloatArray, notices_s: FloatArray
) -> FloatArray:
    """Return (C,) for which share of shifts neither full braking nor hurrying keeps the target clear of each future.

    Args:
        target: the tested vehicle. It does not respond until it notices, and is up to 0.2 s early or late.
        xy_m: (C, T, 2) centres of the other vehicle at ``CHECK_TIMES_S``, one future each.
        yaw_rad: (C, T) its headings.
        size_m: (C, 2) its length and width.
        notices_s: (C,) when it notices each; if it has noticed already (0), it can only brake.
    """
    shares = np.zeros(len(xy_m))
    for time_s in np.unique(notices_s[np.isfinite(notices_s)]).tolist():
        rows = notices_s == time_s
        collides = [
            ~_is_clear(
                target,
                target.way.poses(_shifted_m(driven_m, _SMALL_SHIFTS_S), CHECK_TIMES_S),
                xy_m[rows],
                yaw_rad[rows],
                size_m[rows],
                -CLEARANCE_M,
            )
            for driven_m in target.escape_distances_m(time_s)[: 2 if time_s > 0.0 else 1]
        ]
        shares[rows] = np.all(collides, axis=0).mean(axis=1)
    return shares


def _shifted_m(driven_m: FloatArray, shifts_s: Sequence[float]) -> FloatArray:
    """Return (L, T) distances at ``CHECK_TIMES_S``: those of *driven_m* (121,), shifted in time by *shifts_s* (L,)."""
    times = np.maximum(FINE_TIMES_S[:, None] + np.array(shifts_s), 0.0)
    return np.asarray(np.interp(times, FINE_TIMES_S, driven_m).T[:, FINE_STEPS::FINE_STEPS])


def notices_no_stop_s(to_line_m: float, now_mps: float, driven_m: FloatArray, speed_mps: FloatArray) -> float:
    """Return when a target that expects the other vehicle to stop at a red light notices that it does not.

    That is ``_NOTICE_DELAY_S`` after ``EXPECTED_STOP_MPS2`` no longer stops the other at its line. It is 0 if that is
    so now, and inf if it never is.

    Args:
        to_line_m: present distance of the other's front to its stop line.
        now_mps: its present speed.
        driven_m: (T,) distances that it drives by ``CHECK_TIMES_S``.
        speed_mps: (T,) its speeds.
    """
    if now_mps**2 > 2.0 * EXPECTED_STOP_MPS2 * max(to_line_m, 0.0):
        return 0.0
    too_fast = speed_mps**2 > 2.0 * EXPECTED_STOP_MPS2 * np.maximum(to_line_m - driven_m, 0.0)
    return float(CHECK_TIMES_S[int(too_fast.argmax())]) + _NOTICE_DELAY_S if too_fast.any() else np.inf


def _is_clear(
    target: TargetWay,
    target_poses: tuple[FloatArray, FloatArray],
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    size_m: FloatArray,
    room_m: float = CLEARANCE_M,
) -> BoolArray:
    """Return (C, P) which motions of the target stay clear of which future, by *room_m* before and behind it."""
    half = 0.5 * target.size_m + room_m * np.array([1.0, 0.0])
    own_yaw, other_yaw = np.broadcast_arrays(target_poses[1][None], yaw_rad[:, None])
    offset = xy_m[:, None] - target_poses[0][None]
    gaps = axis_gaps(offset, own_yaw, half, other_yaw, 0.5 * size_m[:, None, None])[0].max(-1)
    return np.asarray((gaps > 0.0).all(axis=-1))
