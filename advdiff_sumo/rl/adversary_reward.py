"""The attacker's reward for half a second: R = R_adv − P_coll (the paper, Sec. III-C), comfort and alignment.

R_adv rewards a collision with the target. It also rewards nearness, to guide learning before the first collision (as
AdvSim does, Wang et al. 2021, doi:10.1109/CVPR46437.2021.00978). P_coll penalises collisions with others and leaving
the road. A Gaussian policy with fixed standard deviation σ whose mean differs from the behaviour model's by δ has a
Kullback-Leibler divergence of |δ|² / 2 σ² from it; ``align`` penalises that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import axis_gaps, corners
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.rl.rl_options import RewardWeights
from advdiff_sumo.sim.world import Frame

TOUCH_M = 0.05
"""Boxes nearer than this touch."""
_JERK_MPS3, _MAX_JERK_TERM = 10.0, 4.0
"""Unit of jerk, and largest squared jerk in that unit that counts."""


@dataclass(frozen=True)
class DecisionInterval:
    """Half a second of an episode, or less at its end, with n + 1 instants and N road users.

    Attributes:
        frames: the instants, from the decision on.
        size_m: (N, 2) length and width.
        attacker: row of the attacker; None without one.
        target: row of the target.
        collided: whether the target's collision ended the episode.
        accel_mps2: the attacker's acceleration in the half second before; None if it was absent, then no jerk counts.
        residual: (2,) its deviation from the behaviour model, in [−1, 1].
        dt_s: spacing of the instants.
    """

    frames: Sequence[Frame]
    size_m: FloatArray
    attacker: int | None
    target: int
    collided: bool
    accel_mps2: float | None
    residual: FloatArray
    dt_s: float


def reward_terms(interval: DecisionInterval, weights: RewardWeights, road: RoadMap) -> dict[str, float]:
    """Return the terms by name; their sum is the reward. Without an attacker only a collision counts."""
    attacker = interval.attacker
    if attacker is None or not _is_present(interval.frames, attacker):
        return {"hit": weights.hit_by_other * interval.collided}
    gaps = _gaps(interval, attacker)  # (n + 1, N)
    gap = max(float(np.nanmin(gaps[:, interval.target])), 0.0)
    by_attacker = interval.collided and gap < TOUCH_M
    jerk = _jerk(interval, attacker)
    return {
        "hit": weights.hit if by_attacker else weights.hit_by_other * interval.collided,
        "near": weights.near * float(np.exp(-gap / weights.near_m)),
        "touch": -weights.touch * float(_touches_another(gaps, interval, attacker)),
        "off_road": -weights.off_road * _off_road(interval, attacker, road),
        "jerk": -weights.jerk * min((jerk / _JERK_MPS3) ** 2, _MAX_JERK_TERM),
        "align": -weights.align * float((interval.residual**2).sum()),
    }


def hit_by_attacker(interval: DecisionInterval) -> bool:
    """Return whether the target collided with the attacker in this interval."""
    attacker = interval.attacker
    if not interval.collided or attacker is None or not _is_present(interval.frames, attacker):
        return False
    return bool(np.nanmin(_gaps(interval, attacker)[:, interval.target]) < TOUCH_M)


def accel_before(past: Sequence[Frame], row: int, step_s: float) -> float | None:
    """Return the acceleration of *row* in m/s² between two instants; None if it was absent.

    Args:
        past: the instants of the previous decision and of this one; fewer at the beginning.
        row: row of the road user.
        step_s: time between them.
    """
    if len(past) < 2 or not _is_present(past, row):
        return None
    return float(past[1].speed_mps[row] - past[0].speed_mps[row]) / step_s


def mean_accel(interval: DecisionInterval, row: int) -> float:
    """Return the mean acceleration of *row* in the interval in m/s²."""
    first, last = interval.frames[0].speed_mps[row], interval.frames[-1].speed_mps[row]
    return float((last - first) / _duration_s(interval))


def _jerk(interval: DecisionInterval, row: int) -> float:
    """Return the jerk of *row* in m/s³; 0 if it was absent before, or if the interval has one instant only.

    An interval has one instant if the target leaves the net in its first simulation step.
    """
    if interval.accel_mps2 is None or len(interval.frames) < 2:
        return 0.0
    return (mean_accel(interval, row) - interval.accel_mps2) / _duration_s(interval)


def _duration_s(interval: DecisionInterval) -> float:
    return interval.dt_s * max(len(interval.frames) - 1, 1)


def _is_present(frames: Sequence[Frame], row: int) -> bool:
    """Return whether *row* is present at every instant."""
    return all(row < len(frame.yaw_rad) and np.isfinite(frame.yaw_rad[row]) for frame in frames)


def _gaps(interval: DecisionInterval, row: int) -> FloatArray:
    """Return the gaps (n + 1, N) from the box of *row* to all others; NaN for absent ones and itself."""
    gaps = np.full((len(interval.frames), len(interval.size_m)), np.nan)
    half_sizes = 0.5 * interval.size_m
    for k, frame in enumerate(interval.frames):
        count = len(frame.yaw_rad)
        yaw = np.full(count, frame.yaw_rad[row])
        offset = frame.xy_m - frame.xy_m[row]
        own_half = np.broadcast_to(half_sizes[row], (count, 2))
        gaps[k, :count] = axis_gaps(offset, yaw, own_half, frame.yaw_rad, half_sizes[:count])[0].max(-1)
    gaps[:, row] = np.nan
    return gaps


def _touches_another(gaps: FloatArray, interval: DecisionInterval, row: int) -> bool:
    """Return whether the attacker begins to touch a road user other than the target."""
    touching: BoolArray = gaps < TOUCH_M  # NaN compares as False
    touching[:, [interval.target, row]] = False
    return bool((touching[1:].any(axis=0) & ~touching[0]).any())


def _off_road(interval: DecisionInterval, row: int, road: RoadMap) -> float:
    frame = interval.frames[-1]
    box = corners(frame.xy_m[row], frame.yaw_rad[row], interval.size_m[row])
    return float(road.off_road_share(box[None])[0])
