"""The braking that a manoeuvre demands of the target, also where its stop takes longer than futures last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.traffic.manoeuvres.answers import (
    BRAKING_MPS2,
    CLEARANCE_M,
    INSUFFICIENT_MPS2,
    REACTION_S,
    TargetWay,
    needed_braking,
)
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures
from advdiff_sumo.traffic.manoeuvres.repertoire import ENDS_STANDING, SLOW_ENTRIES
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
    asks_s = np.array([m.perceivable_s(now[m.row]) for m in manoeuvres])
    needed = needed_braking(target, *_obstacles(view, manoeuvres, futures), asks_s)
    for k, manoeuvre in enumerate(manoeuvres):
        if manoeuvre.kind in SLOW_ENTRIES:
            gains = _gaining(view, target, float(asks_s[k]) + REACTION_S)
            room_m = _gap_m(view, target, manoeuvre) - CLEARANCE_M + futures.driven_m[k]
            matched = _to_match(gains, room_m, float(futures.speed_mps[k, -1]), float(asks_s[k]))
            needed[k] = max(needed[k], matched)
        if manoeuvre.kind in ENDS_STANDING and _stops(manoeuvre):
            stops_m = float(
                futures.driven_m[k, -1] - 0.5 * futures.speed_mps[k, -1] ** 2 / manoeuvre.profile.then_mps2
            )
            room_m = _gap_m(view, target, manoeuvre) + stops_m - CLEARANCE_M
            needed[k] = max(needed[k], _to_stop_within(target, room_m, float(asks_s[k])))
    return needed


def _gap_m(view: SituationView, target: TargetWay, manoeuvre: Manoeuvre) -> float:
    """Return the gap from the target's front to the rear of who drives *manoeuvre*; negative where it is no farther."""
    between_m = 0.5 * float(view.size(manoeuvre.row)[0] + target.size_m[0])
    return view.on_target_way[manoeuvre.row][0] - between_m


def _obstacles(
    view: SituationView, manoeuvres: Sequence[Manoeuvre], futures: ManoeuvreFutures
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres (C, T, 2), headings (C, T) and sizes (C, 2) of whom the target has to mind.

    That is who drives the manoeuvre, or who stands and is revealed by it.
    """
    history = view.scene.history
    xy, yaw = futures.xy_m.copy(), futures.yaw_rad.copy()
    rows = [m.row if m.revealed_row is None else m.revealed_row for m in manoeuvres]
    for k, manoeuvre in enumerate(manoeuvres):
        if manoeuvre.revealed_row is not None:
            xy[k], yaw[k] = (
                history.xy_m[manoeuvre.revealed_row, -1],
                history.yaw_rad[manoeuvre.revealed_row, -1],
            )
    return xy, yaw, history.size_m[rows]


def _stops(manoeuvre: Manoeuvre) -> bool:
    return manoeuvre.profile.then_mps2 < 0.0 and manoeuvre.profile.lowest_mps == 0.0


def _to_stop_within(target: TargetWay, room_m: float, asks_s: float) -> float:
    """Return the mildest braking with which the target, asked in *asks_s*, stops within *room_m*."""
    braked_s = asks_s + REACTION_S
    speed = float(np.interp(braked_s, FINE_TIMES_S, target.free_speed_mps))
    left_m = room_m - float(np.interp(braked_s, FINE_TIMES_S, target.free_distance_m))
    least = 0.5 * speed**2 / left_m if left_m > 0.0 else np.inf
    return next((braking for braking in BRAKING_MPS2 if braking >= least), INSUFFICIENT_MPS2)


def _gaining(view: SituationView, target: TargetWay, until_s: float) -> TargetWay:
    """Return *target* as fast as it will be *until_s* from now if it goes on gaining speed as it does, to its limit."""
    gains = view.speed_gain_mps2(view.scene.target)
    limit = max(target.way.lane.speed_mps, target.speed_mps)
    return replace(target, speed_mps=min(target.speed_mps + gains * until_s, limit)) if gains else target


def _to_match(target: TargetWay, rear_m: FloatArray, then_mps: float, asks_s: float) -> float:
    """Return the mildest braking with which the target stays behind who is ahead and slower, also after 6 s.

    Args:
        target: the tested vehicle.
        rear_m: (T,) how far it could drive by ``CHECK_TIMES_S`` without touching the other.
        then_mps: speed of the other by the last of them, which it keeps.
        asks_s: when the target can perceive it.
    """
    driven, speed = target.braked_motion(BRAKING_MPS2, asks_s + REACTION_S)
    left_m = rear_m - driven
    closing = np.maximum(speed[:, -1] - then_mps, 0.0)
    enough = (left_m > 0.0).all(axis=1) & (closing**2 <= 2.0 * np.array(BRAKING_MPS2) * left_m[:, -1])
    return next((BRAKING_MPS2[k] for k in np.flatnonzero(enough).tolist()), INSUFFICIENT_MPS2)
