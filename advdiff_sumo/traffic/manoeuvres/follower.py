"""Who follows the target: it looks past it, and brakes in time for what the target ought to brake for.

Nobody is asked a question whose right answer ends with somebody else in the target's rear.
"""

from __future__ import annotations

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.metrics.reference.driver_models import FULL_BRAKE_MPS2
from advdiff_sumo.traffic.manoeuvres.answers import BRAKING_MPS2, REACTION_S
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile, drive_profiles

FOLLOWS = "follows"
"""What somebody does who brakes behind the target."""
_BRAKING_MPS2 = BRAKING_MPS2[:-1]
"""Decelerations that are tried, mildest first; who only follows brakes no harder."""
_ROOM_M = 1.0


def braking_behind(view: SituationView, row: int, perceived_s: float) -> Manoeuvre | None:
    """Return the mildest braking with which *row* stays behind a target that gives a careful driver's answer.

    Args:
        view: the scene.
        row: of who follows the target.
        perceived_s: when the target can perceive what it has to brake for; it brakes in full ``REACTION_S`` later.

    Returns:
        The manoeuvre, or None where no braking of ``_BRAKING_MPS2`` is enough.
    """
    target = view.target
    if target is None:
        return None
    careful = target.braked_motion((FULL_BRAKE_MPS2,), perceived_s + REACTION_S)[0][0]
    profiles = [SpeedProfile(0.0, perceived_s + REACTION_S, -braking) for braking in _BRAKING_MPS2]
    clear = np.flatnonzero(_stays_behind(view, row, profiles, careful))
    return Manoeuvre(FOLLOWS, row, view.ways[row], profiles[int(clear[0])]) if len(clear) else None


def still_follows(view: SituationView, manoeuvre: Manoeuvre) -> bool:
    """Return whether who drives *manoeuvre* behind the target stays behind it if that goes on changing its speed."""
    target = view.target
    if target is None:
        return False
    speed = view.scene.history.speed_mps[view.scene.target]
    slows = max(float(speed[-2] - speed[-1]) / view.scene.history.dt_s, 0.0) if len(speed) > 1 else 0.0
    driven = target.braked_motion((slows,), 0.0)[0][0]
    return bool(_stays_behind(view, manoeuvre.row, [manoeuvre.profile], driven)[0])


def _stays_behind(
    view: SituationView, row: int, profiles: list[SpeedProfile], target_driven_m: FloatArray
) -> FloatArray:
    """Return (P,) whether *row* stays ``_ROOM_M`` behind a target that drives *target_driven_m* (T,)."""
    driven, _ = drive_profiles(np.full(len(profiles), view.speed(row)), profiles)
    ahead, _ = view.position_on(view.ways[row], view.scene.target)
    gap = view.gap_m(ahead, row, view.scene.target) + target_driven_m - driven
    return np.asarray((gap > _ROOM_M).all(axis=1))
