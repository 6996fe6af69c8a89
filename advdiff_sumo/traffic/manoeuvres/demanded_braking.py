"""The braking that a manoeuvre requires of the target, also if its stop takes longer than the futures last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures
from advdiff_sumo.traffic.manoeuvres.repertoire import ENDS_STANDING, SLOW_ENTRIES
from advdiff_sumo.traffic.manoeuvres.required_braking import (
    BRAKING_MPS2,
    CLEARANCE_M,
    INSUFFICIENT_MPS2,
    REACTION_S,
    TargetWay,
    needed_braking,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S


def demanded_braking(
    view: SituationView, target: TargetWay, manoeuvres: Sequence[Manoeuvre], futures: ManoeuvreFutures
) -> FloatArray:
    """Return (C,) the mildest of ``BRAKING_MPS2`` with which the target stays clear of each manoeuvre to its end.

    Args:
        view: the scene.
        target: the tested vehicle.
        manoeuvres: C of them.
        futures: the futures of *manoeuvres*.
    """
    xy_m = view.scene.history.xy_m[:, -1]
    perceived_s = np.array([m.perceivable_s(xy_m[m.row]) for m in manoeuvres])
    needed = needed_braking(target, *_obstacles(view, manoeuvres, futures), perceived_s)
    for k, manoeuvre in enumerate(manoeuvres):
        if manoeuvre.kind in SLOW_ENTRIES:
            faster = _after_speeding_up(view, target, float(perceived_s[k]) + REACTION_S)
            room_m = _gap_m(view, target, manoeuvre) - CLEARANCE_M + futures.driven_m[k]
            matched = _to_match_speed(faster, room_m, float(futures.speed_mps[k, -1]), float(perceived_s[k]))
            needed[k] = max(needed[k], matched)
        if manoeuvre.revealed_row is not None:
            revealed, speed_mps = manoeuvre.revealed_row, view.speed(manoeuvre.revealed_row)
            beyond_m = view.position_on(view.ways[manoeuvre.row], revealed)[0]
            ahead_m = view.on_target_way[manoeuvre.row][0] + beyond_m
            gap_m = view.gap_m(ahead_m, revealed, view.scene.target)
            room_m = gap_m - CLEARANCE_M + speed_mps * CHECK_TIMES_S
            needed[k] = max(needed[k], _to_match_speed(target, room_m, speed_mps, float(perceived_s[k])))
        if manoeuvre.kind in ENDS_STANDING and _stops(manoeuvre):
            stop_distance_m = float(
                futures.driven_m[k, -1] - 0.5 * futures.speed_mps[k, -1] ** 2 / manoeuvre.profile.then_mps2
            )
            room_m = _gap_m(view, target, manoeuvre) + stop_distance_m - CLEARANCE_M
            needed[k] = max(needed[k], _to_stop_within(target, room_m, float(perceived_s[k])))
    return needed


def _gap_m(view: SituationView, target: TargetWay, manoeuvre: Manoeuvre) -> float:
    """Return the gap from the target's front to the attacker's rear; negative if that is not ahead of the front."""
    half_lengths_m = 0.5 * float(view.size(manoeuvre.row)[0] + target.size_m[0])
    return view.on_target_way[manoeuvre.row][0] - half_lengths_m


def _obstacles(
    view: SituationView, manoeuvres: Sequence[Manoeuvre], futures: ManoeuvreFutures
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres (C, T, 2), headings (C, T) and sizes (C, 2) of the vehicles that the target must avoid.

    That is the vehicle in the manoeuvre or, in a cut-out, the one that it reveals, which keeps its speed.
    """
    xy, yaw = futures.xy_m.copy(), futures.yaw_rad.copy()
    rows = np.array([m.row if m.revealed_row is None else m.revealed_row for m in manoeuvres])
    reveals = np.array([m.revealed_row is not None for m in manoeuvres])
    if reveals.any():
        xy[reveals], yaw[reveals] = view.constant_speed_poses(rows[reveals])
    return xy, yaw, view.scene.history.size_m[rows]


def _stops(manoeuvre: Manoeuvre) -> bool:
    return manoeuvre.profile.then_mps2 < 0.0 and manoeuvre.profile.lowest_mps == 0.0


def _to_stop_within(target: TargetWay, room_m: float, perceived_s: float) -> float:
    """Return the mildest braking with which the target, which perceives at *perceived_s*, stops within *room_m*."""
    brakes_s = perceived_s + REACTION_S
    speed = float(np.interp(brakes_s, FINE_TIMES_S, target.free_speed_mps))
    left_m = room_m - float(np.interp(brakes_s, FINE_TIMES_S, target.free_distance_m))
    least = 0.5 * speed**2 / left_m if left_m > 0.0 else np.inf
    return next((braking for braking in BRAKING_MPS2 if braking >= least), INSUFFICIENT_MPS2)


def _after_speeding_up(view: SituationView, target: TargetWay, until_s: float) -> TargetWay:
    """Return *target* at its speed *until_s* from now if it keeps its present acceleration, up to its limit."""
    gain = view.speed_gain_mps2(view.scene.target)
    limit = max(target.way.lane.speed_mps, target.speed_mps)
    return replace(target, speed_mps=min(target.speed_mps + gain * until_s, limit)) if gain else target


def _to_match_speed(target: TargetWay, room_m: FloatArray, end_mps: float, perceived_s: float) -> float:
    """Return the mildest braking with which the target stays behind a slower vehicle ahead, also after 6 s.

    Args:
        target: the tested vehicle.
        room_m: (T,) distance that it may drive by ``CHECK_TIMES_S`` without touching the other.
        end_mps: speed of the other at the last of these instants, which it keeps.
        perceived_s: when the target can perceive the other.
    """
    driven, speed = target.braked_motion(BRAKING_MPS2, perceived_s + REACTION_S)
    left_m = room_m - driven
    closing = np.maximum(speed[:, -1] - end_mps, 0.0)
    suffices = (left_m > 0.0).all(axis=1) & (closing**2 <= 2.0 * np.array(BRAKING_MPS2) * left_m[:, -1])
    return next((BRAKING_MPS2[k] for k in np.flatnonzero(suffices).tolist()), INSUFFICIENT_MPS2)
