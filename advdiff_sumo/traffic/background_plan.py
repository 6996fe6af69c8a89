"""What all backgrounds that plan share: what they see, what they may do of what they propose, and when they plan.

A policy supplies its proposal (:class:`Drawn`); licence and safeguard make a plan of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, IntArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.scene import MOTOR_CLASSES, Scene, Tracks
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.view import View, look
from advdiff_sumo.traffic.licence import NATURAL_OVER_LIMIT, LicenceName
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.manoeuvres.licensed_attack import RECKLESS, LicensedAttack, licensed_attack
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.futures import STANDS_MPS, WALKS_MPS, Futures, coasting, futures_of, join
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead, lanes_ahead
from advdiff_sumo.traffic.planning.people import PEOPLE, go_straight, velocities
from advdiff_sumo.traffic.planning.safeguard import (
    SafeguardedPlans,
    SafeguardInput,
    VehiclePlan,
    back_to_lane,
    safeguard,
)
from advdiff_sumo.traffic.planning.way_out import way_out

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap

_LEAVES_M, _LEAVES_S = 12.0, 2.0
_CHANGED_M = 0.1
_SLIPPED_M = 0.3


@dataclass(frozen=True)
class Rules:
    """What attackers may do.

    Attributes:
        licence: its name.
        most: lawful manoeuvres at a time.
        commitments: lawful manoeuvres under way; None: none are driven.
    """

    licence: LicenceName
    most: int
    commitments: Commitments | None = None


@dataclass(frozen=True)
class PlausiblePlan:
    """A plan that licence and safeguard have looked at.

    Attributes:
        tracks: of who is moved.
        attack: what the licence made of the attackers.
        safeguarded: of how many vehicles the next half second was changed, and of how many it was proposed.
        attackers: names of those whose proposed attack is driven: no licence refused it, no manoeuvre replaced it.
    """

    tracks: Tracks
    attack: LicensedAttack
    safeguarded: tuple[int, int]
    attackers: tuple[str, ...]


def outlook(
    road: RoadMap, scene: Scene, map_view: MapView = "near"
) -> tuple[View, dict[int, LaneAhead | None]]:
    """Return *scene* for the networks, less who leaves the net, and the lanes that each movable row would follow."""
    lanes = lanes_of(road, scene)
    return look(road, scene, leaving(scene, lanes), map_view=map_view), lanes


def plausible_plan(
    road: RoadMap,
    view: View,
    lanes: Mapping[int, LaneAhead | None],
    drawn: Drawn,
    before: tuple[Tracks | None, int],
    rules: Rules,
) -> PlausiblePlan:
    """Return the plan of who is moved, out of a proposal.

    Args:
        road: the map.
        view: the scene.
        lanes: what each movable vehicle, by its row in the scene, would follow.
        drawn: the proposal.
        before: the last plan and how many model steps of it have been driven.
        rules: for the attackers.
    """
    futures = futures_of(view.now, drawn.rollout)
    attackers = drawn.attackers
    attack = licensed_attack(road, view, futures, attackers, rules.licence, rules.commitments, rules.most)
    guarded = apply_safeguard(road, view, drawn, lanes, before, attack)
    free = np.setdiff1d(np.flatnonzero(view.moved), list(attack.driven))
    away = np.linalg.norm(guarded.futures.xy_m[free, 1] - futures.xy_m[free, 1], axis=-1)
    lost = {view.ids[row] for row in (*attack.refused, *attack.driven)}
    return PlausiblePlan(
        tracks_of(view, guarded.futures),
        attack,
        (int((away > _CHANGED_M).sum()), len(free)),
        tuple(name for name in attackers if name not in lost),
    )


def nobody(scene: Scene) -> Tracks:
    """Return the plan where nobody may be moved."""
    return Tracks.empty(steps=1, dt_s=MODEL_STEP_S, t0_s=scene.time_s + MODEL_STEP_S)


def driven_of(plan: Tracks | None, scene: Scene) -> int:
    """Return how many model steps of the last *plan* have been driven by now, by its clock; 1 at least."""
    return 1 if plan is None else max(round((scene.time_s - plan.t0_s) / plan.dt_s) + 1, 1)


def rest_of(road: RoadMap, plan: Tracks | None, before: int, scene: Scene, replan: int) -> Tracks | None:
    """Return what is left of the last plan, where it shall be driven on and names everybody that may be moved.

    Who is about to leave the net is not moved. The rest has to last until the next plan, for as many steps as passed
    since it was handed out last.

    Args:
        road: the map.
        plan: the last one.
        before: model steps of it that had been driven when it was handed out last.
        scene: now.
        replan: model steps of a plan to drive.
    """
    driven = driven_of(plan, scene)
    if plan is None or driven >= replan or plan.steps < 2 * driven - before:
        return None
    late = abs(plan.t0_s + (driven - 1) * plan.dt_s - scene.time_s) > 1e-6
    if late:
        return None
    moved = scene.movable & ~leaving(scene, lanes_of(road, scene))
    if {name for name, free in zip(scene.history.ids, moved, strict=True) if free} != set(plan.ids):
        return None
    return plan.window(driven, plan.steps)


def lanes_of(road: RoadMap, scene: Scene) -> dict[int, LaneAhead | None]:
    """Return the lanes that each movable vehicle, by its row, would follow."""
    rows = np.flatnonzero(scene.movable & scene.history.valid[:, -1])
    now = scene.history
    ahead = lanes_ahead(
        road, now.xy_m[rows, -1], now.yaw_rad[rows, -1], [scene.routes[row] for row in rows.tolist()]
    )
    return dict(zip(rows.tolist(), ahead, strict=True))


def leaving(scene: Scene, lanes: Mapping[int, LaneAhead | None]) -> BoolArray:
    """Return (agents,) which vehicles are about to drive off the net's end."""
    out = np.zeros(scene.history.agents, dtype=np.bool_)
    for row, lane in lanes.items():
        if lane is not None:
            speed = max(float(scene.history.speed_mps[row, -1]), 0.0)
            out[row] = lane.end_m < _LEAVES_M + _LEAVES_S * speed
    return out


def apply_safeguard(
    road: RoadMap,
    view: View,
    drawn: Drawn,
    lanes: Mapping[int, LaneAhead | None],
    before: tuple[Tracks | None, int] = (None, 0),
    attack: LicensedAttack = RECKLESS,
) -> SafeguardedPlans:
    """Return the plans *drawn* for *view* made plausible, among everybody else's predictions.

    Args:
        road: the map.
        view: the scene.
        drawn: the plans.
        lanes: what each movable vehicle, by its row in the scene, would follow.
        before: the last plan and how many model steps of it have been driven.
        attack: what the licence makes of the attackers.
    """
    futures, scene = futures_of(view.now, drawn.rollout), view.scene
    rest = np.setdiff1d(np.flatnonzero(scene.history.valid[:, -1]), view.rows)
    rows = np.concatenate((view.rows, rest))
    watched = _watched(road, view, rows, lanes, drawn.attackers, attack)
    watched = replace(watched, before=_rests(*before, view, futures.steps))
    for row, plan in attack.driven.items():
        futures.put(row, *plan)
    back_to_lane(futures, np.array(attack.refused, dtype=np.int64), watched)
    now = scene.history
    joined = join(
        futures,
        coasting(
            now.xy_m[rest, -1],
            now.yaw_rad[rest, -1],
            now.speed_mps[rest, -1],
            now.size_m[rest],
            futures.steps,
            futures.dt_s,
        ),
    )
    go_straight(joined, watched.people & ~_with_rest(view.moved, rest), velocities(now)[rows])
    return safeguard(road, joined, watched)


def _watched(
    road: RoadMap,
    view: View,
    rows: IntArray,
    lanes: Mapping[int, LaneAhead | None],
    attackers: Sequence[str],
    attack: LicensedAttack,
) -> SafeguardInput:
    """Return what the safeguard has to know of *rows* (N,) of the scene, those of the view first."""
    scene, rest = view.scene, rows[len(view.ids) :]
    guided = np.isin(view.ids, attackers)
    driven = np.isin(np.arange(len(view.ids)), list(attack.driven))
    planned = view.moved & ~driven
    dawdled = _slower(view.now, WALKS_MPS)
    ahead = [lanes.get(row) for row in rows.tolist()]
    for row in np.flatnonzero(planned & dawdled).tolist():
        if ahead[row] is None:
            ahead[row] = way_out(road, view.now.xy_m[row, -1], float(view.now.yaw_rad[row, -1]))
    over_limit = np.where(guided, attack.over_limit, NATURAL_OVER_LIMIT)
    waits = np.array([attack.waits_m.get(row, np.inf) for row in range(len(rows))])
    return SafeguardInput(
        planned=_with_rest(planned, rest),
        attacker=_with_rest(guided & attack.exempt, rest),
        target=0,
        motor=np.isin(scene.history.classes[rows], MOTOR_CLASSES),
        people=np.isin(scene.history.classes[rows], PEOPLE),
        stood=_with_rest(_slower(view.now, STANDS_MPS) & ~driven, rest),
        dawdled=_with_rest(dawdled, rest),
        over_limit=np.concatenate((over_limit, np.ones(len(rest)))),
        lanes=ahead,
        signals=scene.signals,
        waits_m=waits,
        keeps_back=not attack.exempt,
        lanes_afar=attack.exempt,
    )


def _with_rest(mask: BoolArray, rest: IntArray) -> BoolArray:
    """Return *mask* of the view's agents, and False for the *rest* of the scene."""
    return np.concatenate((mask, np.zeros(len(rest), dtype=np.bool_)))


def _rests(plan: Tracks | None, driven: int, view: View, steps: int) -> dict[int, VehiclePlan]:
    """Return by row of *view* what is left of the last plan, gone on with at its last speed, for *steps* instants.

    Who is not where its plan had it by now is left out.
    """
    if plan is None or not 0 < driven < plan.steps:
        return {}
    rest = {name: row for row, name in enumerate(plan.ids)}
    ahead = np.arange(driven, driven + steps)
    index, beyond = np.minimum(ahead, plan.steps - 1), plan.dt_s * np.maximum(ahead - plan.steps + 1, 0)
    out: dict[int, VehiclePlan] = {}
    for row in np.flatnonzero(view.moved).tolist():
        mine = rest.get(view.ids[row])
        if mine is None:
            continue
        if np.linalg.norm(plan.xy_m[mine, driven - 1] - view.now.xy_m[row, -1]) < _SLIPPED_M:
            yaw, speed = plan.yaw_rad[mine, index], plan.speed_mps[mine, index]
            out[row] = plan.xy_m[mine, index] + (speed * beyond)[:, None] * unit(yaw), yaw, speed
    return out


def _slower(now: Tracks, speed_mps: float) -> BoolArray:
    """Return (A,) who has been there, slower than *speed_mps*, for the whole history."""
    return np.asarray((now.valid & (np.abs(now.speed_mps) < speed_mps)).all(axis=1))


def tracks_of(view: View, futures: Futures) -> Tracks:
    """Return the plans of the moved vehicles."""
    rows = np.flatnonzero(view.moved)
    plans = futures.mapped(lambda part: part[rows, 1:])
    return view.now.rows(rows).driving(plans, view.scene.time_s + futures.dt_s, futures.dt_s)
