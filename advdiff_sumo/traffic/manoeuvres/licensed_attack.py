"""What a licence makes of a plan: unlawful plans are refused or wait, and lawful manoeuvres are added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.licence import (
    LAWFUL,
    RECKLESS_OVER_LIMIT,
    Licence,
    LicenceName,
    licence_of,
)
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.manoeuvre import planned_motions
from advdiff_sumo.traffic.manoeuvres.obstruction import WAITS
from advdiff_sumo.traffic.manoeuvres.plan_breaches import CARELESS_ALLOWS, plan_breaches
from advdiff_sumo.traffic.manoeuvres.required_braking import BRAKING_MPS2, needed_braking
from advdiff_sumo.traffic.manoeuvres.schedule import insert_vehicles, update_manoeuvres
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer
from advdiff_sumo.traffic.manoeuvres.target_lane_change import blocks_lane_change
from advdiff_sumo.traffic.manoeuvres.waiting_for_target import waiting_lines_m
from advdiff_sumo.traffic.planning.futures import Futures

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap

PAUSE_S = 8.0
"""Rest of a vehicle after a manoeuvre."""
SETS_OFF_MPS = 6.0
"""A resting vehicle that is slower than this follows its lane until it is up to speed."""


@dataclass(frozen=True)
class LicensedAttack:
    """What attackers do; rows are those of the view.

    Attributes:
        exempt: whether attackers may ignore red lights, lanes and the target itself (the licence "reckless").
        refused: rows that follow their lanes, as their plans would break a rule or they set off after a manoeuvre.
        driven: row → positions (T, 2), headings (T,) and speeds (T,) of a lawful manoeuvre.
        commitments: manoeuvres under way, for the next plan.
        over_limit: highest share of the speed limit at which guided vehicles may drive.
        newcomers: vehicles that are inserted.
        waits_m: row → how far it may drive before the target, which has the right of way over it, has passed.
    """

    exempt: bool = True
    refused: tuple[int, ...] = ()
    driven: Mapping[int, tuple[FloatArray, FloatArray, FloatArray]] = field(default_factory=dict)
    commitments: Commitments | None = None
    over_limit: float = RECKLESS_OVER_LIMIT
    newcomers: tuple[Newcomer, ...] = ()
    waits_m: Mapping[int, float] = field(default_factory=dict)


UNRESTRICTED = LicensedAttack()
"""Anything that moves like a vehicle, up to 1.5 × the limit: the paper's, with a bound on its speed."""


def licensed_attack(
    road: RoadMap,
    view: View,
    futures: Futures,
    attackers: tuple[str, ...],
    name: LicenceName,
    memory: Commitments | None,
    max_manoeuvres: int,
) -> LicensedAttack:
    """Return which parts of a joint plan may be driven, and the manoeuvres that are driven beside it.

    Args:
        road: the map.
        view: the scene.
        futures: planned for the view's rows.
        attackers: ids of the guided vehicles.
        name: name of the licence.
        memory: manoeuvres under way; None: none are added.
        max_manoeuvres: most manoeuvres at a time, beside the guided vehicles.
    """
    licence = licence_of(name)
    if licence is None:
        return UNRESTRICTED
    situation = situation_of(road, view, memory)
    driven: dict[int, tuple[FloatArray, FloatArray, FloatArray]] = {}
    newcomers: tuple[Newcomer, ...] = ()
    if memory is not None:
        manoeuvres, memory = update_manoeuvres(situation, memory, max_manoeuvres, PAUSE_S, licence)
        view_row_of = {row: k for k, row in enumerate(view.rows.tolist())}
        xy, yaw, planned_speed = planned_motions(situation, manoeuvres)
        for k, manoeuvre in enumerate(manoeuvres):
            if manoeuvre.kind != WAITS:  # the safeguard keeps vehicles clear of boxes by itself
                driven[view_row_of[manoeuvre.row]] = xy[k], yaw[k], planned_speed[k]
        newcomers, memory = insert_vehicles(situation, memory)
        movable_rows = {name: k for k, name in enumerate(view.ids) if view.moved[k]}
        driven |= {
            movable_rows[name]: motion
            for name, motion in memory.standing.motions(view.scene.time_s)
            if name in movable_rows
        }
    guided = [row for row in map(view.ids.index, attackers) if row not in driven]
    refused = _refused(situation, view, futures, guided, licence) | _setting_off(view, memory, driven)
    lines_m = waiting_lines_m(situation, view.rows.tolist(), futures).tolist()
    waits_m = {k: line for k, line in enumerate(lines_m) if np.isfinite(line)}
    return LicensedAttack(
        False, tuple(sorted(refused)), driven, memory, licence.over_limit, newcomers, waits_m
    )


def situation_of(road: RoadMap, view: View, memory: Commitments | None) -> SituationView:
    """Return the scene of *view* with ways; only vehicles that get a plan may be moved in it.

    It holds the road users near the target, and those that a leader hides from it.
    """
    movable = np.zeros_like(view.scene.movable)
    movable[view.rows[view.moved]] = True
    hidden = memory.standing.hidden_names if memory is not None else ()
    return SituationView.of(road, replace(view.scene, movable=movable), hidden)


def _setting_off(view: View, memory: Commitments | None, driven: Mapping[int, object]) -> set[int]:
    """Return which rows are slow after a manoeuvre; the model, which saw them brake, would let them stand."""
    if memory is None:
        return set()
    now, is_slow = view.scene.time_s, view.scene.history.speed_mps[view.rows, -1] < SETS_OFF_MPS
    is_resting = [memory.rested_s.get(name, now) > now for name in view.ids]
    return set(np.flatnonzero(view.moved & is_slow & is_resting).tolist()) - driven.keys()


def _refused(
    situation: SituationView, view: View, futures: Futures, guided: list[int], licence: Licence
) -> set[int]:
    """Return which of the *guided* rows break a rule or leave the target no sufficient braking.

    That is all of them if the target is on no lane.
    """
    target = situation.target
    if target is None or not guided:
        return set(guided)
    futures = futures.lasting(round(CHECK_TIMES_S[-1] / futures.dt_s))
    xy, yaw = futures.halves()
    speed = np.empty(yaw.shape)
    speed[:, 1::2] = futures.speed_mps[:, 1:]
    speed[:, ::2] = 0.5 * (futures.speed_mps[:, 1:] + futures.speed_mps[:, :-1])
    rows = [int(view.rows[k]) for k in guided]
    breaches = plan_breaches(situation, rows, xy[guided], yaw[guided], speed[guided])
    allowed = CARELESS_ALLOWS if licence is not LAWFUL else frozenset()
    refused = {k for k, kinds in zip(guided, breaches, strict=True) if kinds - allowed}
    perceived_s = np.zeros(len(guided))
    needed = needed_braking(target, xy[guided], yaw[guided], futures.size_m[guided], perceived_s)
    is_blocking = blocks_lane_change(situation, rows, xy[guided], yaw[guided])
    refused |= set(np.array(guided)[is_blocking].tolist())
    is_insufficient = needed > BRAKING_MPS2[-1]
    return refused | set(np.array(guided)[is_insufficient].tolist())
