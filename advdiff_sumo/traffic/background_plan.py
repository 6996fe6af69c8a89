"""Turns the proposal of a policy into a plan; shared by all backgrounds that plan.

A policy supplies a proposal (:class:`Drawn`). Licence and safeguard make a plan of it.
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
from advdiff_sumo.traffic.manoeuvres.licensed_attack import UNRESTRICTED, LicensedAttack, licensed_attack
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.futures import (
    STANDS_MPS,
    WALKS_MPS,
    Futures,
    constant_velocity_futures,
    futures_of,
    join,
)
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead, lanes_of_rows
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
"""A vehicle is about to leave the net if it reaches the end within this distance plus this time."""
_CHANGED_M = 0.1
"""The safeguard changed a plan if it moved its first instant farther than this."""
_DEVIATION_M = 0.3
"""A vehicle farther than this from its previous plan does not continue it."""


@dataclass(frozen=True)
class Rules:
    """What attackers may do.

    Attributes:
        licence: name of the licence.
        max_manoeuvres: largest number of simultaneous lawful manoeuvres.
        commitments: lawful manoeuvres under way; None: no manoeuvres.
    """

    licence: LicenceName
    max_manoeuvres: int
    commitments: Commitments | None = None


@dataclass(frozen=True)
class PlausiblePlan:
    """A plan after licence and safeguard.

    Attributes:
        tracks: plans of the moved vehicles.
        attack: attack that the licence allows.
        safeguarded: number of vehicles whose next half second was changed, and number of proposed plans.
        attackers: ids of vehicles that drive their proposed attack, neither refused nor replaced by a manoeuvre.
    """

    tracks: Tracks
    attack: LicensedAttack
    safeguarded: tuple[int, int]
    attackers: tuple[str, ...]


def view_and_lanes(
    road: RoadMap, scene: Scene, map_view: MapView = "near"
) -> tuple[View, dict[int, LaneAhead | None]]:
    """Return the networks' view of *scene* and, by row, the lanes that each movable vehicle would follow.

    Vehicles that are about to leave the net are not moved.
    """
    lanes = lanes_of(road, scene)
    return look(road, scene, leaves_net(scene, lanes), map_view=map_view), lanes


def plausible_plan(
    road: RoadMap,
    view: View,
    lanes: Mapping[int, LaneAhead | None],
    drawn: Drawn,
    before: tuple[Tracks | None, int],
    rules: Rules,
) -> PlausiblePlan:
    """Return the plan of the moved vehicles, made of a proposal.

    Args:
        road: the map.
        view: the scene.
        lanes: row of the scene → lanes that the vehicle would follow.
        drawn: the proposal.
        before: the previous plan and the number of model steps of it that have been driven.
        rules: what attackers may do.
    """
    futures = futures_of(view.now, drawn.rollout)
    attackers = drawn.attackers
    attack = licensed_attack(
        road, view, futures, attackers, rules.licence, rules.commitments, rules.max_manoeuvres
    )
    guarded = apply_safeguard(road, view, drawn, lanes, before, attack)
    proposed = np.setdiff1d(np.flatnonzero(view.moved), list(attack.driven))
    shift = np.linalg.norm(guarded.futures.xy_m[proposed, 1] - futures.xy_m[proposed, 1], axis=-1)
    overruled = {view.ids[row] for row in (*attack.refused, *attack.driven)}
    return PlausiblePlan(
        tracks_of(view, guarded.futures),
        attack,
        (int((shift > _CHANGED_M).sum()), len(proposed)),
        tuple(name for name in attackers if name not in overruled),
    )


def empty_plan(scene: Scene) -> Tracks:
    """Return a plan that moves no vehicle."""
    return Tracks.empty(steps=1, dt_s=MODEL_STEP_S, t0_s=scene.time_s + MODEL_STEP_S)


def steps_driven(plan: Tracks | None, scene: Scene) -> int:
    """Return the number of model steps of the previous *plan* driven by now, at least 1."""
    return 1 if plan is None else max(round((scene.time_s - plan.t0_s) / plan.dt_s) + 1, 1)


def remaining_plan(
    road: RoadMap, plan: Tracks | None, before: int, scene: Scene, replan: int
) -> Tracks | None:
    """Return the rest of the previous plan; None if a new plan is due or the rest cannot be used.

    It can be used if it covers exactly the vehicles to be moved, and if it lasts until the next call, as many steps
    from now as passed since the previous one. Vehicles that are about to leave the net are not moved.

    Args:
        road: the map.
        plan: the previous plan.
        before: number of its model steps that had been driven at the previous call.
        scene: the scene now.
        replan: number of model steps of a plan to drive.
    """
    driven = steps_driven(plan, scene)
    if plan is None or driven >= replan or plan.steps < 2 * driven - before:
        return None
    if abs(plan.t0_s + (driven - 1) * plan.dt_s - scene.time_s) > 1e-6:  # now is between its instants
        return None
    to_move = scene.movable & ~leaves_net(scene, lanes_of(road, scene))
    if {name for name, is_moved in zip(scene.history.ids, to_move, strict=True) if is_moved} != set(plan.ids):
        return None
    return plan.window(driven, plan.steps)


def lanes_of(road: RoadMap, scene: Scene) -> dict[int, LaneAhead | None]:
    """Return, by row, the lanes that each movable vehicle would follow."""
    rows = np.flatnonzero(scene.movable & scene.history.valid[:, -1])
    return dict(zip(rows.tolist(), lanes_of_rows(road, scene, rows), strict=True))


def leaves_net(scene: Scene, lanes: Mapping[int, LaneAhead | None]) -> BoolArray:
    """Return (agents,) which vehicles are about to leave the net."""
    leaves = np.zeros(scene.history.agents, dtype=np.bool_)
    for row, lane in lanes.items():
        if lane is not None:
            speed = max(float(scene.history.speed_mps[row, -1]), 0.0)
            leaves[row] = lane.end_m < _LEAVES_M + _LEAVES_S * speed
    return leaves


def apply_safeguard(
    road: RoadMap,
    view: View,
    drawn: Drawn,
    lanes: Mapping[int, LaneAhead | None],
    before: tuple[Tracks | None, int] = (None, 0),
    attack: LicensedAttack = UNRESTRICTED,
) -> SafeguardedPlans:
    """Return the proposed plans after the safeguard, among predictions of all other road users.

    Args:
        road: the map.
        view: the scene.
        drawn: the proposal.
        lanes: row of the scene → lanes that the vehicle would follow.
        before: the previous plan and the number of model steps of it that have been driven.
        attack: attack that the licence allows.
    """
    futures, scene = futures_of(view.now, drawn.rollout), view.scene
    outside = np.setdiff1d(np.flatnonzero(scene.history.valid[:, -1]), view.rows)  # rows not in the view
    rows = np.concatenate((view.rows, outside))
    inputs = _safeguard_input(road, view, rows, lanes, drawn.attackers, attack)
    inputs = replace(inputs, previous=_previous_plans(*before, view, futures.steps))
    for row, plan in attack.driven.items():
        futures.put(row, *plan)
    back_to_lane(futures, np.array(attack.refused, dtype=np.int64), inputs)
    now = scene.history
    joined = join(
        futures,
        constant_velocity_futures(
            now.xy_m[outside, -1],
            now.yaw_rad[outside, -1],
            now.speed_mps[outside, -1],
            now.size_m[outside],
            futures.steps,
            futures.dt_s,
        ),
    )
    go_straight(joined, inputs.is_unprotected & ~_padded(view.moved, len(outside)), velocities(now)[rows])
    return safeguard(road, joined, inputs)


def _safeguard_input(
    road: RoadMap,
    view: View,
    rows: IntArray,
    lanes: Mapping[int, LaneAhead | None],
    attackers: Sequence[str],
    attack: LicensedAttack,
) -> SafeguardInput:
    """Return the input of the safeguard for *rows* (N,) of the scene, those of the view first."""
    scene, outside = view.scene, len(rows) - len(view.ids)
    guided = np.isin(view.ids, attackers)
    in_manoeuvre = np.isin(np.arange(len(view.ids)), list(attack.driven))
    planned = view.moved & ~in_manoeuvre
    has_crept = _was_slower(view.now, WALKS_MPS)
    ahead = [lanes.get(row) for row in rows.tolist()]
    for row in np.flatnonzero(planned & has_crept).tolist():
        if ahead[row] is None:
            ahead[row] = way_out(road, view.now.xy_m[row, -1], float(view.now.yaw_rad[row, -1]))
    limit_share = np.where(guided, attack.over_limit, NATURAL_OVER_LIMIT)
    yield_stop_m = np.array([attack.waits_m.get(row, np.inf) for row in range(len(rows))])
    return SafeguardInput(
        is_planned=_padded(planned, outside),
        is_attacker=_padded(guided & attack.exempt, outside),
        target=0,
        is_motor=np.isin(scene.history.classes[rows], MOTOR_CLASSES),
        is_unprotected=np.isin(scene.history.classes[rows], PEOPLE),
        has_stood=_padded(_was_slower(view.now, STANDS_MPS) & ~in_manoeuvre, outside),
        has_crept=_padded(has_crept, outside),
        limit_share=np.concatenate((limit_share, np.ones(outside))),
        lanes=ahead,
        signals=scene.signals,
        yield_stop_m=yield_stop_m,
        keep_gap=not attack.exempt,
        far_follow_lanes=attack.exempt,
    )


def _padded(mask: BoolArray, count: int) -> BoolArray:
    """Return *mask* with False for *count* further road users."""
    return np.concatenate((mask, np.zeros(count, dtype=np.bool_)))


def _previous_plans(plan: Tracks | None, driven: int, view: View, steps: int) -> dict[int, VehiclePlan]:
    """Return, by row of *view*, the rest of the previous plan, continued at its last speed to *steps* instants.

    Vehicles that are not where their plan expects them now are left out.
    """
    if plan is None or not 0 < driven < plan.steps:
        return {}
    plan_rows = {name: row for row, name in enumerate(plan.ids)}
    ahead = np.arange(driven, driven + steps)
    index, beyond = np.minimum(ahead, plan.steps - 1), plan.dt_s * np.maximum(ahead - plan.steps + 1, 0)
    previous: dict[int, VehiclePlan] = {}
    for row in np.flatnonzero(view.moved).tolist():
        plan_row = plan_rows.get(view.ids[row])
        if plan_row is None:
            continue
        if np.linalg.norm(plan.xy_m[plan_row, driven - 1] - view.now.xy_m[row, -1]) < _DEVIATION_M:
            yaw, speed = plan.yaw_rad[plan_row, index], plan.speed_mps[plan_row, index]
            previous[row] = plan.xy_m[plan_row, index] + (speed * beyond)[:, None] * unit(yaw), yaw, speed
    return previous


def _was_slower(history: Tracks, speed_mps: float) -> BoolArray:
    """Return (A,) which vehicles have been present and slower than *speed_mps* for the whole history."""
    return np.asarray((history.valid & (np.abs(history.speed_mps) < speed_mps)).all(axis=1))


def tracks_of(view: View, futures: Futures) -> Tracks:
    """Return the plans of the moved vehicles."""
    rows = np.flatnonzero(view.moved)
    plans = futures.mapped(lambda part: part[rows, 1:])
    return view.now.rows(rows).with_states(plans, view.scene.time_s + futures.dt_s, futures.dt_s)
