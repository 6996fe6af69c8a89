"""The vehicle behind the target: it brakes early for what the target must brake for.

An encounter must not end with a rear-end collision into a target that responds correctly.
"""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.metrics.reference.driver_models import FULL_BRAKE_MPS2
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.required_braking import BRAKING_MPS2, REACTION_S
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile, drive_profiles

FOLLOWS = "follows"
"""Kind of manoeuvre of a vehicle that brakes behind the target."""
_BRAKING_MPS2 = BRAKING_MPS2[:-1]
"""Decelerations that are tried, mildest first; a follower brakes no harder."""
_MIN_GAP_M = 1.0


def braking_behind(view: SituationView, row: int, perceived_s: float) -> Manoeuvre | None:
    """Return the mildest braking with which *row* stays behind a target that responds like a careful driver.

    Args:
        view: the scene.
        row: row of the follower.
        perceived_s: when the target can perceive what it must brake for; it brakes fully ``REACTION_S`` later.

    Returns:
        The manoeuvre, or None if no braking of ``_BRAKING_MPS2`` is enough.
    """
    target = view.target
    if target is None:
        return None
    target_driven_m = target.braked_motion((FULL_BRAKE_MPS2,), perceived_s + REACTION_S)[0][0]
    profiles = [SpeedProfile(0.0, perceived_s + REACTION_S, -braking) for braking in _BRAKING_MPS2]
    sufficient = np.flatnonzero(_stays_behind(view, row, profiles, target_driven_m))
    return Manoeuvre(FOLLOWS, row, view.ways[row], profiles[int(sufficient[0])]) if len(sufficient) else None


def still_follows(view: SituationView, manoeuvre: Manoeuvre) -> bool:
    """Return whether *manoeuvre* keeps the follower behind a target that keeps its present deceleration."""
    target = view.target
    if target is None:
        return False
    slowing_mps2 = max(-view.accel_mps2(view.scene.target), 0.0)
    target_driven_m = target.braked_motion((slowing_mps2,), 0.0)[0][0]
    return bool(_stays_behind(view, manoeuvre.row, [manoeuvre.profile], target_driven_m)[0])


def _stays_behind(
    view: SituationView, row: int, profiles: list[SpeedProfile], target_driven_m: FloatArray
) -> FloatArray:
    """Return (P,) whether *row* stays ``_MIN_GAP_M`` behind a target that drives *target_driven_m* (T,)."""
    driven, _ = drive_profiles(np.full(len(profiles), view.speed(row)), profiles)
    ahead, _ = view.position_on(view.ways[row], view.scene.target)
    gap = view.gap_m(ahead, row, view.scene.target) + target_driven_m - driven
    return np.asarray((gap > _MIN_GAP_M).all(axis=1))
