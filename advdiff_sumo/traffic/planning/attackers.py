"""Who attacks: the vehicles that would come nearest to the target anyway and can do what is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import local_from_world
from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.planning.futures import Futures

STICKY_M = 8.0
"""An attacker is kept unless another one would come nearer than it by so much."""
FARTHEST_M = 45.0
"""Who stays farther away than this throughout is of no use."""
IN_LANE_M = 2.0
"""Who is ahead of the target, and no farther to the side of its way, leads it."""
HARDLY_MOVES_MPS = 2.0
"""Nobody is guided against a target that drives more slowly, unless attackers may ram."""
_SLANTED = np.cos(np.radians(40.0))


@dataclass(frozen=True)
class Standing:
    """Where N vehicles are as the target sees them, now; each (N,).

    Attributes:
        ahead_m: along its heading.
        left_m: to its left.
        same: cosine of the angle between the headings.
        crosses: whether it drives, now or in its natural future, across the target's heading.
    """

    ahead_m: FloatArray
    left_m: FloatArray
    same: FloatArray
    crosses: BoolArray


def choose(futures: Futures, moved: BoolArray, attack: str, count: int, before: BoolArray) -> IntArray:
    """Return the rows of at most *count* attackers, the most promising first.

    Args:
        futures: natural futures; row 0 is the target.
        moved: (N,) who can be guided at all.
        attack: the kind.
        count: most of them.
        before: (N,) who attacked last.
    """
    near = closest_m(futures)
    fit = moved & eligible(standing_of(futures), attack) & (near < FARTHEST_M)
    fit[0] = False
    score = np.where(fit, near - STICKY_M * before, np.inf)
    order = np.argsort(score, kind="stable")[:count]
    return np.asarray(order[np.isfinite(score[order])], dtype=np.int64)


def can_attack(futures: Futures, moved: BoolArray, licence: LicenceName) -> BoolArray:
    """Return (N,) whom a guide may draw to the target.

    Unless they are "reckless": nobody behind the target, who could only ram it, nobody who leads it, who would come
    nearer by standing in its way and nothing else, and nobody while it stands.

    Args:
        futures: natural futures; row 0 is the target.
        moved: (N,) who can be guided at all.
        licence: what attackers may do.
    """
    if licence == "reckless":
        return moved
    if futures.speed_mps[0, 0] < HARDLY_MOVES_MPS:
        return np.zeros_like(moved)
    return np.asarray(moved & (standing_of(futures).ahead_m > 0.0) & ~_is_on_way_of_target(futures))


def _is_on_way_of_target(futures: Futures) -> BoolArray:
    """Return (N,) who drives on the natural way of the target, or that carried straight on, in its direction."""
    way, yaw = futures.xy_m[0], futures.yaw_rad[0]
    nearest = np.linalg.norm(futures.xy_m[:, :1] - way, axis=-1).argmin(axis=1)
    left = local_from_world(futures.xy_m[:, 0], way[nearest], yaw[nearest])[:, 1]
    along = np.cos(futures.yaw_rad[:, 0] - yaw[nearest]) > _SLANTED
    return np.asarray(along & (np.abs(left) < IN_LANE_M))


def closest_m(futures: Futures) -> FloatArray:
    """Return (N,) the closest natural approach of each to the target, between centres less half lengths."""
    gap = np.linalg.norm(futures.xy_m - futures.xy_m[:1], axis=-1).min(axis=1)
    return np.asarray(gap - 0.5 * (futures.size_m[:, 0] + futures.size_m[0, 0]))


def standing_of(futures: Futures) -> Standing:
    """Return where everybody is as the target (row 0) sees them."""
    yaw = futures.yaw_rad[0, 0]
    offset = local_from_world(futures.xy_m[:, 0], futures.xy_m[0, 0], np.full(futures.agents, yaw))
    angle = np.abs(np.cos(futures.yaw_rad - futures.yaw_rad[:1]))
    return Standing(
        ahead_m=offset[:, 0],
        left_m=offset[:, 1],
        same=np.cos(futures.yaw_rad[:, 0] - yaw),
        crosses=np.asarray((angle < _SLANTED).any(axis=1)),
    )


def eligible(where: Standing, attack: str) -> BoolArray:
    """Return (N,) who is in a position for *attack*."""
    ahead, side = where.ahead_m, np.abs(where.left_m)
    along, against = where.same > _SLANTED, where.same < -_SLANTED
    fits: dict[str, BoolArray] = {
        "any": np.ones(len(ahead), dtype=np.bool_),
        "cut-in": along & (side > 1.5) & (side < 8.0) & (ahead > -15.0) & (ahead < 35.0),
        "brake": along & (side < IN_LANE_M) & (ahead > 0.0) & (ahead < 45.0),
        "rear-end": along & (side < 6.0) & (ahead < 0.0) & (ahead > -45.0),
        "head-on": against & (side < 10.0) & (ahead > 0.0),
        "junction": where.crosses & ((ahead > 0.0) | (side > 3.0)),
    }
    return fits[attack]
