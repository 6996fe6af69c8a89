"""Checks final plans with the breach rules of the verdict: would its vehicle be at fault in a collision?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.metrics.breaches import BreachKind, breaches_of, conduct_breaches
from advdiff_sumo.metrics.collision import tracks_collisions
from advdiff_sumo.metrics.encounter import encounter_of
from advdiff_sumo.metrics.traffic_view import TrafficView
from advdiff_sumo.traffic.manoeuvres.required_braking import BRAKING_MPS2, TargetWay
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_DT_S, CHECK_TIMES_S
from advdiff_sumo.traffic.manoeuvres.target_lane_change import target_entering

CARELESS_ALLOWS = frozenset((BreachKind.UNSAFE_LANE_ENTRY, BreachKind.SPEEDING))
"""Breaches that the licence "careless" limits by its own bounds."""
_TARGET_BRAKING_MPS2 = (BRAKING_MPS2[0], 4.0)


def plan_breaches(
    view: SituationView, rows: Sequence[int], xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray
) -> list[frozenset[BreachKind]]:
    """Return for each of R plans which rules its vehicle would break.

    Each plan is tried with a target that follows its way without braking, and with one that brakes at 4 m/s²; where
    the target is changing lanes, with one that completes the lane change as well.

    Args:
        view: the scene; its target is on a lane.
        rows: (R,) rows of the vehicles.
        xy_m: (R, T, 2) centres at ``CHECK_TIMES_S``.
        yaw_rad: (R, T) headings.
        speed_mps: (R, T) speeds.

    Raises:
        ValueError: the target is on no lane, so its way is unknown.
    """
    if view.target is None:
        raise ValueError("no plan can be judged against a target that is on no lane")
    broken: list[set[BreachKind]] = [set() for _ in rows]
    entering = target_entering(view)
    targets = (view.target,) if entering is None else (view.target, entering)
    for target, braking in product(targets, _TARGET_BRAKING_MPS2):
        planned = _planned(view, target, rows, (xy_m, yaw_rad, speed_mps), braking)
        for row, kinds in _contact_breaches(planned).items():
            broken[row - 1] |= kinds
        first_step = planned.tracks.steps - len(CHECK_TIMES_S)
        for k in range(len(rows)):
            conduct = conduct_breaches(planned, k + 1, first_step, planned.tracks.steps)
            broken[k] |= {breach.kind for breach in conduct}
    return [frozenset(kinds) for kinds in broken]


def _contact_breaches(planned: TrafficView) -> Mapping[int, set[BreachKind]]:
    """Return row → kinds of breach that led to its contact with the target, which is row 0."""
    breaches: dict[int, set[BreachKind]] = {}
    for contact in tracks_collisions(planned.tracks, 0):
        if contact.rows[0] == 0 and not contact.initial:
            kinds = {b.kind for b in breaches_of(planned, encounter_of(planned, contact), 1)}
            breaches.setdefault(contact.rows[1], set()).update(kinds)
    return breaches


def _planned(
    view: SituationView,
    target: TargetWay,
    rows: Sequence[int],
    plans: tuple[FloatArray, FloatArray, FloatArray],
    braking_mps2: float,
) -> TrafficView:
    """Return the target and *rows* over their history and their plans; the target brakes with *braking_mps2*."""
    driven, speed = target.braked_motion((braking_mps2,), 0.0)
    xy, yaw = target.way.poses(driven, CHECK_TIMES_S)
    history = view.scene.history.rows([view.scene.target, *rows])
    past = resample(history, CHECK_DT_S)
    tracks = Tracks(
        ids=past.ids,
        classes=past.classes,
        size_m=past.size_m,
        xy_m=np.concatenate((past.xy_m, np.concatenate((xy, plans[0]))), axis=1),
        yaw_rad=np.concatenate((past.yaw_rad, np.concatenate((yaw, plans[1]))), axis=1),
        speed_mps=np.concatenate((past.speed_mps, np.concatenate((speed, plans[2]))), axis=1),
        valid=np.concatenate((past.valid, np.ones((len(past.ids), len(CHECK_TIMES_S)), np.bool_)), axis=1),
        t0_s=past.t0_s,
        dt_s=CHECK_DT_S,
    )
    routes = {
        0: view.scene.routes[view.scene.target],
        **{k + 1: view.scene.routes[r] for k, r in enumerate(rows)},
    }
    known_routes = {k: route for k, route in routes.items() if route}
    return TrafficView(tracks, view.road, (view.scene.signals,) * tracks.steps, known_routes)
