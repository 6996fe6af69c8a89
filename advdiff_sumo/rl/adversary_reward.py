"""What an attacker is paid for half a second: R = R_adv − P_coll (the paper, Sec. III-C), comfort and alignment.

R_adv pays for a collision with the target and, so that there is something to follow before the first one, for
nearness (as AdvSim does, Wang et al. 2021, doi:10.1109/CVPR46437.2021.00978). P_coll asks for collisions with others
and for leaving the road. A Gaussian policy of fixed deviation σ that differs from the behaviour model's by δ
in its mean is |δ|² / 2 σ² away in the sense of Kullback and Leibler; ``align`` asks for that.
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
_JERK_MPS3, _MOST_JERK = 10.0, 4.0


@dataclass(frozen=True)
class DecisionInterval:
    """Half a second of an episode, less where it ends within, as the reward needs it; n + 1 instants, N road users.

    Attributes:
        frames: the instants, the first is that of the decision.
        size_m: (N, 2) length and width.
        attacker: its row; None where nobody attacked.
        target: row of the target.
        collided: the target's collision ended the episode here.
        accel_mps2: the attacker's acceleration in the half second before; None where it was not there: no jerk counts.
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


def reward_terms(half: DecisionInterval, weights: RewardWeights, road: RoadMap) -> dict[str, float]:
    """Return the terms by name; their sum is the reward. Where nobody attacked, only a collision counts."""
    attacker = half.attacker
    if attacker is None or not _there(half.frames, attacker):
        return {"hit": weights.hit_by_other * half.collided}
    gaps = _gaps(half, attacker)  # (n + 1, N)
    room = max(float(np.nanmin(gaps[:, half.target])), 0.0)
    by_it = half.collided and room < TOUCH_M
    jerk = _jerk(half, attacker)
    return {
        "hit": weights.hit if by_it else weights.hit_by_other * half.collided,
        "near": weights.near * float(np.exp(-room / weights.near_m)),
        "touch": -weights.touch * float(_touches_another(gaps, half, attacker)),
        "off_road": -weights.off_road * _off_road(half, attacker, road),
        "jerk": -weights.jerk * min((jerk / _JERK_MPS3) ** 2, _MOST_JERK),
        "align": -weights.align * float((half.residual**2).sum()),
    }


def hit_by_attacker(half: DecisionInterval) -> bool:
    """Return whether the target's collision in this interval is with the attacker."""
    attacker = half.attacker
    if not half.collided or attacker is None or not _there(half.frames, attacker):
        return False
    return bool(np.nanmin(_gaps(half, attacker)[:, half.target]) < TOUCH_M)


def accel_before(past: Sequence[Frame], row: int, step_s: float) -> float | None:
    """Return the acceleration of *row* in m/s² from one to the next of two instants; None where it was not there.

    Args:
        past: the instants of the last decision and of this one; fewer where nothing is known of the time before.
        row: whose.
        step_s: between them.
    """
    if len(past) < 2 or not _there(past, row):
        return None
    return float(past[1].speed_mps[row] - past[0].speed_mps[row]) / step_s


def mean_accel(half: DecisionInterval, row: int) -> float:
    """Return the mean acceleration of *row* in the half second."""
    first, last = half.frames[0].speed_mps[row], half.frames[-1].speed_mps[row]
    return float((last - first) / _span_s(half))


def _jerk(half: DecisionInterval, row: int) -> float:
    """Return the jerk of *row* in m/s³, 0 where it was not there before, or the half second has one instant alone.

    It has where the target leaves the net in the first of its steps.
    """
    if half.accel_mps2 is None or len(half.frames) < 2:
        return 0.0
    return (mean_accel(half, row) - half.accel_mps2) / _span_s(half)


def _span_s(half: DecisionInterval) -> float:
    return half.dt_s * max(len(half.frames) - 1, 1)


def _there(frames: Sequence[Frame], row: int) -> bool:
    """Return whether *row* is there at every instant."""
    return all(row < len(f.yaw_rad) and np.isfinite(f.yaw_rad[row]) for f in frames)


def _gaps(half: DecisionInterval, row: int) -> FloatArray:
    """Return the room (n + 1, N) between the attacker's box and everybody's; NaN for absent ones and itself."""
    out = np.full((len(half.frames), len(half.size_m)), np.nan)
    box = 0.5 * half.size_m
    for k, frame in enumerate(half.frames):
        count = len(frame.yaw_rad)
        own = np.full(count, frame.yaw_rad[row])
        offset = frame.xy_m - frame.xy_m[row]
        mine = np.broadcast_to(box[row], (count, 2))
        out[k, :count] = axis_gaps(offset, own, mine, frame.yaw_rad, box[:count])[0].max(-1)
    out[:, row] = np.nan
    return out


def _touches_another(gaps: FloatArray, half: DecisionInterval, row: int) -> bool:
    """Return whether the attacker comes to touch anybody but the target, whom it did not touch before."""
    touching: BoolArray = gaps < TOUCH_M  # NaN compares as False
    touching[:, [half.target, row]] = False
    return bool((touching[1:].any(axis=0) & ~touching[0]).any())


def _off_road(half: DecisionInterval, row: int, road: RoadMap) -> float:
    frame = half.frames[-1]
    box = corners(frame.xy_m[row], frame.yaw_rad[row], half.size_m[row])
    return float(road.off_road_share(box[None])[0])
