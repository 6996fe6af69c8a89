"""The attack ``double``: the target's leader stops hard while other vehicles are nearer to the target.

The others block nobody. A planner that tracks only the nearest few road users, or only the nearest one ahead, tracks
them instead of the leader.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.traffic.manoeuvres.company import COMPANY_SIZE, company_places, is_settled
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.repertoire import DOUBLE, hard_stop
from advdiff_sumo.traffic.manoeuvres.required_braking import (
    BRAKING_MPS2,
    REACTION_S,
    TargetWay,
    needed_braking,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S


def hard_stop_in_company(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield hard stops of the target's leader while others are nearer, or leading at a steady gap until they are."""
    for stop in hard_stop(view, row) if company_places(view) else ():
        double = replace(stop, kind=DOUBLE)
        if stop.is_positioning or is_masked(view, double):
            yield double


def is_masked(view: SituationView, stop: Manoeuvre) -> bool:
    """Return whether a planner that tracks only the nearest road users perceives *stop* too late.

    This must hold for a planner that tracks only the nearest one ahead. While the company may still come nearer, it
    must also hold for one that tracks the nearest ``COMPANY_SIZE``.
    """
    target = view.target
    if target is None:
        return False
    futures = futures_of_manoeuvres([stop], np.array([view.speed(stop.row)]))
    behind_company, behind_one_ahead = _masks(view, target, stop.row, futures.xy_m[0])
    too_late = [
        _is_too_late(view, target, stop, futures, mask) for mask in (behind_company, behind_one_ahead)
    ]
    return too_late[1] and (too_late[0] or is_settled(view))


def _is_too_late(
    view: SituationView, target: TargetWay, stop: Manoeuvre, futures: ManoeuvreFutures, mask: BoolArray
) -> bool:
    """Return whether full braking is too late if the target does not respond before *mask* (T,) first is False."""
    seen_s = float(CHECK_TIMES_S[-1] if mask.all() else CHECK_TIMES_S[int(np.argmin(mask))])
    perceived_s = np.array([max(seen_s - REACTION_S, 0.0)])
    size = view.size(stop.row)[None]
    needed = needed_braking(target, futures.xy_m, futures.yaw_rad, size, perceived_s)
    return bool(needed[0] > BRAKING_MPS2[-1])


def _masks(view: SituationView, target: TargetWay, row: int, xy_m: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return when (T,) *row*, at *xy_m* (T, 2), is none of the nearest ``COMPANY_SIZE``, and not the nearest ahead."""
    others = np.array([r for r in view.ways if r not in (row, view.scene.target)], dtype=np.int64)
    target_xy, target_yaw = target.way.poses(target.braked_motion((0.0,), 0.0)[0][0], CHECK_TIMES_S)
    offset = view.constant_speed_poses(others)[0] - target_xy
    distance = np.linalg.norm(offset, axis=-1)
    is_nearer = distance < np.linalg.norm(xy_m - target_xy, axis=-1)
    is_ahead = (offset * unit(target_yaw)).sum(axis=-1) > 0.0
    return is_nearer.sum(axis=0) >= COMPANY_SIZE, (is_nearer & is_ahead).any(axis=0)
