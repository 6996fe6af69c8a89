"""The attack ``double``: the target's leader stops hard while others, in nobody's way, are nearer to the target.

A planner that tracks the nearest few road users, or the nearest ahead alone, has those in mind in place of the leader.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.traffic.manoeuvres.answers import BRAKING_MPS2, REACTION_S, TargetWay, needed_braking
from advdiff_sumo.traffic.manoeuvres.company import COMPANY_SIZE, company_places, is_settled
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.repertoire import DOUBLE, hard_stop
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S


def hard_stop_in_company(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """The target's leader stops hard while others are nearer to the target, or leads it until they are."""
    for stop in hard_stop(view, row) if company_places(view) else ():
        again = replace(stop, kind=DOUBLE)
        if stop.sets_up or is_masked(view, again):
            yield again


def is_masked(view: SituationView, stop: Manoeuvre) -> bool:
    """Return whether who minds only the nearest road users sees *stop* too late.

    That is who minds the nearest ahead alone and, as long as the company may still come nearer, who minds the nearest
    ``COMPANY_SIZE``.
    """
    target = view.target
    if target is None:
        return False
    futures = futures_of_manoeuvres([stop], np.array([view.speed(stop.row)]))
    of_three, of_ahead = _masks(view, target, stop.row, futures.xy_m[0])
    late = [_is_late(view, target, stop, futures, masked) for masked in (of_three, of_ahead)]
    return late[1] and (late[0] or is_settled(view))


def _is_late(
    view: SituationView, target: TargetWay, stop: Manoeuvre, futures: ManoeuvreFutures, masked: BoolArray
) -> bool:
    """Return whether full braking as soon as *masked* (T,) ends is too late, with the target going on until then."""
    seen_s = float(CHECK_TIMES_S[-1] if masked.all() else CHECK_TIMES_S[int(np.argmin(masked))])
    perceived_s = np.array([max(seen_s - REACTION_S, 0.0)])
    size = view.size(stop.row)[None]
    return bool(
        needed_braking(target, futures.xy_m, futures.yaw_rad, size, perceived_s)[0] > BRAKING_MPS2[-1]
    )


def _masks(view: SituationView, target: TargetWay, row: int, xy_m: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return (T,) when *row*, at *xy_m* (T, 2), is none of the nearest ``COMPANY_SIZE``, and not the nearest ahead."""
    others = np.array([r for r in view.ways if r not in (row, view.scene.target)], dtype=np.int64)
    place, yaw = target.way.poses(target.braked_motion((0.0,), 0.0)[0][0], CHECK_TIMES_S)
    offset = view.constant_speed_poses(others)[0] - place
    apart = np.linalg.norm(offset, axis=-1)
    nearer = apart < np.linalg.norm(xy_m - place, axis=-1)
    ahead = (offset * unit(yaw)).sum(axis=-1) > 0.0
    return nearer.sum(axis=0) >= COMPANY_SIZE, (nearer & ahead).any(axis=0)
