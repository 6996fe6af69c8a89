"""Chooses attackers: vehicles in a position for the attack that would come nearest to the target anyway."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import local_from_world
from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.planning.futures import Futures

STICKY_M = 8.0
"""An attacker is kept unless another vehicle would come nearer by more than this."""
FARTHEST_M = 45.0
"""A vehicle that never comes nearer than this cannot attack."""
IN_LANE_M = 2.0
"""A vehicle ahead of the target leads it if its lateral offset is less than this."""
HARDLY_MOVES_MPS = 2.0
"""No vehicle is guided against a slower target, except by reckless attackers."""
_PARALLEL_COS = np.cos(np.radians(40.0))
"""Headings whose cosine exceeds this count as parallel."""


@dataclass(frozen=True)
class Standing:
    """Present poses of N vehicles relative to the target, each (N,).

    Attributes:
        ahead_m: longitudinal offset, positive ahead of the target.
        left_m: lateral offset, positive to its left.
        heading_cos: cosine of the angle between the headings.
        crosses: whether it drives across the target's heading, now or in its natural future.
    """

    ahead_m: FloatArray
    left_m: FloatArray
    heading_cos: FloatArray
    crosses: BoolArray


def choose(
    futures: Futures, moved: BoolArray, attack: str, count: int, attacked_before: BoolArray
) -> IntArray:
    """Return the rows of at most *count* attackers, the most promising first.

    Args:
        futures: natural futures; row 0 is the target.
        moved: (N,) whether the vehicle can be guided.
        attack: kind of attack.
        count: largest number of attackers.
        attacked_before: (N,) whether it attacked in the previous plan.
    """
    approach = closest_m(futures)
    is_candidate = moved & eligible_mask(standing_of(futures), attack) & (approach < FARTHEST_M)
    is_candidate[0] = False
    score = np.where(is_candidate, approach - STICKY_M * attacked_before, np.inf)
    order = np.argsort(score, kind="stable")[:count]
    return np.asarray(order[np.isfinite(score[order])], dtype=np.int64)


def can_attack(futures: Futures, moved: BoolArray, licence: LicenceName) -> BoolArray:
    """Return (N,) which vehicles a guide may steer towards the target.

    Under "reckless" these are all *moved* ones. Otherwise none behind the target is, as it could only ram it, and
    none that leads it, as it could only come nearer by blocking its way. None is while the target stands or creeps.

    Args:
        futures: natural futures; row 0 is the target.
        moved: (N,) whether the vehicle can be guided.
        licence: what attackers may do.
    """
    if licence == "reckless":
        return moved
    if futures.speed_mps[0, 0] < HARDLY_MOVES_MPS:
        return np.zeros_like(moved)
    return np.asarray(moved & (standing_of(futures).ahead_m > 0.0) & ~_leads_target(futures))


def _leads_target(futures: Futures) -> BoolArray:
    """Return (N,) which vehicles drive along the target's natural path, or along the straight line beyond its end."""
    path, yaw = futures.xy_m[0], futures.yaw_rad[0]
    nearest = np.linalg.norm(futures.xy_m[:, :1] - path, axis=-1).argmin(axis=1)
    left = local_from_world(futures.xy_m[:, 0], path[nearest], yaw[nearest])[:, 1]
    along = np.cos(futures.yaw_rad[:, 0] - yaw[nearest]) > _PARALLEL_COS
    return np.asarray(along & (np.abs(left) < IN_LANE_M))


def closest_m(futures: Futures) -> FloatArray:
    """Return (N,) the smallest distance to the target in the natural futures, between centres less half lengths."""
    gap = np.linalg.norm(futures.xy_m - futures.xy_m[:1], axis=-1).min(axis=1)
    return np.asarray(gap - 0.5 * (futures.size_m[:, 0] + futures.size_m[0, 0]))


def standing_of(futures: Futures) -> Standing:
    """Return the present poses relative to the target (row 0)."""
    yaw = futures.yaw_rad[0, 0]
    offset = local_from_world(futures.xy_m[:, 0], futures.xy_m[0, 0], np.full(futures.agents, yaw))
    alignment = np.abs(np.cos(futures.yaw_rad - futures.yaw_rad[:1]))
    return Standing(
        ahead_m=offset[:, 0],
        left_m=offset[:, 1],
        heading_cos=np.cos(futures.yaw_rad[:, 0] - yaw),
        crosses=np.asarray((alignment < _PARALLEL_COS).any(axis=1)),
    )


def eligible_mask(poses: Standing, attack: str) -> BoolArray:
    """Return (N,) whether each vehicle is in a position for *attack*."""
    ahead, side = poses.ahead_m, np.abs(poses.left_m)
    same_way, oncoming = poses.heading_cos > _PARALLEL_COS, poses.heading_cos < -_PARALLEL_COS
    in_position: dict[str, BoolArray] = {
        "any": np.ones(len(ahead), dtype=np.bool_),
        "cut-in": same_way & (side > 1.5) & (side < 8.0) & (ahead > -15.0) & (ahead < 35.0),
        "brake": same_way & (side < IN_LANE_M) & (ahead > 0.0) & (ahead < 45.0),
        "rear-end": same_way & (side < 6.0) & (ahead < 0.0) & (ahead > -45.0),
        "head-on": oncoming & (side < 10.0) & (ahead > 0.0),
        "junction": poses.crosses & ((ahead > 0.0) | (side > 3.0)),
    }
    return in_position[attack]
