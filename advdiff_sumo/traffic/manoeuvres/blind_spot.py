"""The attack ``blind-spot``: a vehicle stays beside the target on the next lane, a little behind its centre.

Once it is there, the target's leader slows, so that the target would like to change lanes. One that looks ahead and to
its side only, not back, moves into the vehicle beside.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from advdiff_sumo.traffic.manoeuvres.close_pass import lets_in, passing_rows
from advdiff_sumo.traffic.manoeuvres.company import local_position
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.repertoire import BLIND_SPOT, MIN_STOPPING_SPEED_MPS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import ADAPTS_S, SpeedProfile

OVERLAP_M = 1.2
"""Length along the road over which both boxes overlap, front of the vehicle beside and rear of the target."""
_CLOSING_PER_S, _MAX_CLOSING_MPS = 0.5, 5.0
"""Speed difference per metre off that place, and the largest one."""
_ACCEL_MPS2, _BRAKING_MPS2 = 2.0, 4.0
_BEGINS_M = 1.5  # distance from its place at which it no longer only gets into position


def blind_spot(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield how *row* gets to or keeps its place beside the target, and nothing where it lets the target in."""
    target = view.target
    if target is None or row not in passing_rows(view) or lets_in(view, row):
        return
    if min(target.speed_mps, view.speed(row)) < MIN_STOPPING_SPEED_MPS:
        return
    way, half_lengths_m = view.ways[row], 0.5 * float(view.size(row)[0] + target.size_m[0])
    off_m = OVERLAP_M - half_lengths_m - local_position(view, row)[0]
    faster_mps = float(np.clip(_CLOSING_PER_S * off_m, -_MAX_CLOSING_MPS, _MAX_CLOSING_MPS))
    target_then = target.speed_mps + ADAPTS_S * view.accel_mps2(view.scene.target)
    wish = min(max(target_then + faster_mps, 0.0), way.lane.speed_mps)
    profile = SpeedProfile.adapting(
        wish, view.speed(row), _BRAKING_MPS2, _ACCEL_MPS2, 0.0, way.lane.speed_mps
    )
    yield Manoeuvre(BLIND_SPOT, row, way, profile, is_positioning=abs(off_m) > _BEGINS_M)
