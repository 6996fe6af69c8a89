"""The braking that a manoeuvre demands of the target, also where its stop takes longer than futures last."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.traffic.manoeuvres.answers import (
    BRAKING_MPS2,
    REACTION_S,
    ROOM_M,
    UNANSWERABLE_MPS2,
    TargetWay,
    needed_braking,
)
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures
from advdiff_sumo.traffic.manoeuvres.repertoire import ENDS_STANDING
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView


def demanded_braking(
    view: SituationView, target: TargetWay, manoeuvres: Sequence[Manoeuvre], futures: ManoeuvreFutures
) -> FloatArray:
    """Return (C,) the mildest of ``BRAKING_MPS2`` with which the target stays clear of each manoeuvre to its end.

    Args:
        view: the scene.
        target: the tested vehicle.
        manoeuvres: C of them.
        futures: of them.
    """
    now = view.scene.history.xy_m[:, -1]
    asks_s = np.array([m.asks_s(now[m.row]) for m in manoeuvres])
    needed = needed_braking(target, *_obstacles(view, manoeuvres, futures), asks_s)
    for k, manoeuvre in enumerate(manoeuvres):
        if manoeuvre.kind in ENDS_STANDING and _stops(manoeuvre):
            stops_m = float(
                futures.driven_m[k, -1] - 0.5 * futures.speed_mps[k, -1] ** 2 / manoeuvre.profile.then_mps2
            )
            between_m = 0.5 * float(view.size(manoeuvre.row)[0] + target.size_m[0])
            room_m = view.on_target_way[manoeuvre.row][0] - between_m + stops_m - ROOM_M
            needed[k] = max(needed[k], _to_stop_within(target, room_m, float(asks_s[k])))
    return needed


def _obstacles(
    view: SituationView, manoeuvres: Sequence[Manoeuvre], futures: ManoeuvreFutures
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres (C, T, 2), headings (C, T) and sizes (C, 2) of whom the target has to mind.

    That is who drives the manoeuvre, or who stands and is revealed by it.
    """
    history = view.scene.history
    xy, yaw = futures.xy_m.copy(), futures.yaw_rad.copy()
    rows = [m.row if m.reveals is None else m.reveals for m in manoeuvres]
    for k, manoeuvre in enumerate(manoeuvres):
        if manoeuvre.reveals is not None:
            xy[k], yaw[k] = history.xy_m[manoeuvre.reveals, -1], history.yaw_rad[manoeuvre.reveals, -1]
    return xy, yaw, history.size_m[rows]


def _stops(manoeuvre: Manoeuvre) -> bool:
    return manoeuvre.profile.then_mps2 < 0.0 and manoeuvre.profile.lowest_mps == 0.0


def _to_stop_within(target: TargetWay, room_m: float, asks_s: float) -> float:
    """Return the mildest braking with which the target, asked in *asks_s*, stops within *room_m*."""
    braked_s = asks_s + REACTION_S
    speed = float(np.interp(braked_s, FINE_TIMES_S, target.goes_on_mps))
    left_m = room_m - float(np.interp(braked_s, FINE_TIMES_S, target.goes_on_m))
    least = 0.5 * speed**2 / left_m if left_m > 0.0 else np.inf
    return next((braking for braking in BRAKING_MPS2 if braking >= least), UNANSWERABLE_MPS2)
