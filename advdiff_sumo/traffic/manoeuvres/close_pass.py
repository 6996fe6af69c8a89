"""The attack ``close-pass``: a vehicle on the lane beside passes the target slowly, close to the line between them.

Once it is alongside, the target's leader slows, so that the target would like to change lanes. One that does so without
a look to the side, or that does not keep its lane, moves into the vehicle beside.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import replace

import numpy as np

from advdiff_sumo.maps.lanes import SIDES
from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.company import company_rows, has_lane_beside, local_position
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_manoeuvres
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.repertoire import CLOSE_PASSING, MIN_STOPPING_SPEED_MPS, leads
from advdiff_sumo.traffic.manoeuvres.required_braking import TargetWay
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import kerb_side
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.target_lane_change import required_side, target_entering

SLOW_LEADER = "slow-leader"
"""Kind of manoeuvre of the leader that the target would like to overtake."""
PASSES_MPS = 1.0
"""Speed difference while both are side by side."""
LINE_M, CLEARANCE_M = 0.15, 0.7
"""Distance that the passing box keeps to the line, and to the target's box across its lane."""
_MIN_CLEARANCE_M = 0.5  # with less room nobody passes
_BEGINS_M, _ENDS_M = 4.0, 2.0
"""Bumper gap at which the pass begins; gap beyond the target at which it is over."""
_CLOSING_PER_S, _MAX_CLOSING_MPS = 0.4, 5.0  # speed difference per metre, before the pass
_ACCEL_MPS2 = 2.0
_LEADER_SHARES, _LEADER_BRAKING_MPS2 = (0.8, 0.5), 1.5
"""Shares of the limit at which the leader drives: before a vehicle is alongside the target, and then."""


def close_pass(view: SituationView, row: int) -> Iterator[Manoeuvre]:
    """Yield the pass of *row* on the lane beside the target, or how it comes alongside."""
    target = view.target
    if target is None or min(target.speed_mps, view.speed(row)) < MIN_STOPPING_SPEED_MPS:
        return
    passing = _passing(view, target, row) if row in passing_rows(view) else None
    if passing is not None and not lets_in(view, row):
        is_far = _bumper_gap_m(view, row) > _BEGINS_M
        yield replace(passing, is_positioning=is_far)


def continued_pass(view: SituationView, row: int) -> Manoeuvre | None:
    """Return how a pass goes on; None once it is over, or where the target enters the lane ahead of *row*."""
    target = view.target
    if target is None or row not in (*company_rows(view, "left"), *company_rows(view, "right")):
        return None
    if _is_passed(view, target, row) or lets_in(view, row):
        return None
    return _passing(view, target, row)


def pass_sides(view: SituationView) -> Sequence[str]:
    """Return the sides of the target with a lane on which a vehicle may pass.

    The first is the one to which its route makes it change lanes, otherwise the overtaking side.
    """
    target = view.target
    first = required_side(view) or ("right" if kerb_side(view) == "left" else "left")
    order = sorted(SIDES, key=lambda side: side != first)
    return [side for side in order if target is not None and has_lane_beside(view, target, side)]


def slow_leaders(
    view: SituationView, busy: Container[int], licence: Licence | None = LAWFUL
) -> list[Manoeuvre]:
    """Return how the target's leader, unless it is *busy*, gets to and keeps a low speed; [] if there is none."""
    leaders = (
        row for row in view.movable if leads(view, row) and view.is_clear_to(view.on_target_way[row][0])
    )
    row = next(leaders, None)
    if row is None or row in busy or not pass_sides(view):
        return []
    way, speed = view.ways[row], view.speed(row)
    share = _LEADER_SHARES[any(_bumper_gap_m(view, passing) < _BEGINS_M for passing in passing_rows(view))]
    slow_mps = max(share * way.lane.speed_mps, MIN_STOPPING_SPEED_MPS)
    bounds = min(slow_mps, speed), max(slow_mps, speed)
    profile = SpeedProfile.adapting(slow_mps, speed, _LEADER_BRAKING_MPS2, _ACCEL_MPS2, *bounds)
    lasting = replace(profile, switch_s=np.inf)  # until it drives at that speed
    return lawful_manoeuvres(view, [Manoeuvre(SLOW_LEADER, row, way, lasting, is_positioning=True)], licence)


def passing_rows(view: SituationView) -> Sequence[int]:
    """Return the row next to the target on the first of its ``pass_sides`` that does not drive away from it, or ()."""
    target = view.target
    if target is None:
        return ()
    rows = (row for side in pass_sides(view)[:1] for row in company_rows(view, side))
    return [row for row in rows if not _is_passed(view, target, row)][:1]


def _passing(view: SituationView, target: TargetWay, row: int) -> Manoeuvre | None:
    """Return how *row* passes or comes alongside; None if it has not enough room, or may not drive fast enough."""
    way = view.ways[row]
    gap_m, limit = _bumper_gap_m(view, row), way.lane.speed_mps
    behind_m, gains_mps = -local_position(view, row)[0], view.speed(row) - target.speed_mps
    direction = np.sign(behind_m if gap_m > 0.0 else gains_mps) or 1.0
    keeps_left_m = _lateral_place_m(view, row)
    if keeps_left_m is None or (direction > 0.0 and limit < target.speed_mps + 0.5 * PASSES_MPS):
        return None
    faster_mps = min(PASSES_MPS + _CLOSING_PER_S * max(gap_m - _BEGINS_M, 0.0), _MAX_CLOSING_MPS)
    wish = float(np.clip(target.speed_mps + direction * faster_mps, MIN_STOPPING_SPEED_MPS, limit))
    profile = SpeedProfile.adapting(wish, view.speed(row), _ACCEL_MPS2, _ACCEL_MPS2, 0.0, limit)
    return Manoeuvre(CLOSE_PASSING, row, replace(way, keeps_left_m=keeps_left_m), profile)


def _lateral_place_m(view: SituationView, row: int) -> float | None:
    """Return the place left of its lane's centre line at which *row* passes; None if the target leaves no room."""
    way, width_m = view.ways[row], float(view.size(row)[1])
    target_xy = view.scene.history.xy_m[view.scene.target, -1]
    target_left_m = float(way.line.project(target_xy, extrapolate=True)[1])  # it may be before the first lane
    room_m = abs(target_left_m) - 0.5 * (width_m + float(view.size(view.scene.target)[1]))
    reach_m = max(0.5 * (way.present_lane.width_m - width_m) - LINE_M, 0.0)
    if room_m + reach_m < _MIN_CLEARANCE_M:
        return None
    return float(np.sign(target_left_m) * np.clip(room_m - CLEARANCE_M, -reach_m, reach_m))


def _bumper_gap_m(view: SituationView, row: int) -> float:
    """Return the gap along the road between *row* and the target; negative if they are side by side."""
    return view.gap_m(local_position(view, row)[0], row, view.scene.target)


def _is_passed(view: SituationView, target: TargetWay, row: int) -> bool:
    """Return whether *row* is beyond the target and drives away from it, as the faster or the slower one."""
    away_mps = np.sign(local_position(view, row)[0]) * (view.speed(row) - target.speed_mps)
    return bool(_bumper_gap_m(view, row) > _ENDS_M and away_mps > 0.0)


def lets_in(view: SituationView, row: int) -> bool:
    """Return whether *row* is behind the target, which is changing to its lane."""
    target, (ahead_m, left_m) = view.target, local_position(view, row)
    if target is None or target_entering(view) is None or left_m * target.way.drift_mps < 0.0:
        return False
    return ahead_m < 0.0 < _bumper_gap_m(view, row)
