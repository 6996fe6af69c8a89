"""Vehicles whose way the target blocks without being their leader in SUMO: they perceive its box and stop before it.

SUMO's drivers follow lanes. They do not see a target that stands across their lane or beside its own. A vehicle that
has the target as its leader is left to SUMO, except in two cases: it would have to brake harder than SUMO's drivers
ever do for a leader, or it accelerates towards a target for which it should brake.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.required_braking import REACTION_S
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile

WAITS = "waits"
"""Kind of manoeuvre of a vehicle whose way the target blocks."""
_SIDE_M, _REDUCED_SIDE_M = 0.25, 0.05
"""Lateral distance to a box on the way; and after waiting for ``_REDUCED_AFTER_S``."""
_REDUCED_AFTER_S = 8.0
_USUAL_BRAKING_MPS2, _MAX_BRAKING_MPS2 = 2.5, 8.5
_SUMO_MISSES_MPS2, _NEXT_PLAN_S = 5.0, 0.5
"""If this braking is required at the next plan, SUMO does not follow the target: its drivers brake with 4.5 m/s²."""
_SUMO_ACCEL_MPS2, _MIN_BRAKING_MPS2 = 2.6, 0.5
"""Acceleration of SUMO's drivers; least braking of a vehicle that must not accelerate."""
_STOP_BEFORE_M, _HOLD_WITHIN_M, _STANDING_MPS = 1.0, 2.0, 0.3
"""Gap at which a vehicle stops; a standing one is held within ``_HOLD_WITHIN_M`` more of a standing obstacle."""
_MIN_SUMO_GAP_M = 2.0  # SUMO lets no vehicle stand closer behind its leader
_MAX_LATERAL_MPS = 1.0  # an obstacle that moves across faster clears the way by itself
_EDGE: FloatArray = np.linspace(-0.5, 0.5, 9)
_SIDE: FloatArray = np.full_like(_EDGE, 0.5)
_OUTLINE: FloatArray = np.concatenate(
    [np.stack(pair, -1) for pair in ((_EDGE, _SIDE), (_EDGE, -_SIDE), (_SIDE, _EDGE), (-_SIDE, _EDGE))]
)
"""(36, 2) points on the outline of a box of length and width 1."""


def blocked_since(view: SituationView, since_s: Mapping[str, float]) -> Mapping[str, float]:
    """Return id → time since when the target's box has blocked the way of each vehicle."""
    now, ids = view.scene.time_s, view.scene.history.ids
    return {
        ids[row]: since_s.get(ids[row], now)
        for row in view.movable
        if row != view.scene.target and _is_blocked(view, row, now - since_s.get(ids[row], now))
    }


def waiting_manoeuvres(view: SituationView, since_s: Mapping[str, float]) -> list[Manoeuvre]:
    """Return the manoeuvres of vehicles that brake, or stand, as their way has been blocked for their reaction time.

    SUMO keeps the vehicles before a line at which they may have to stop.

    Args:
        view: the scene.
        since_s: of :func:`blocked_since`.
    """
    rows = [
        view.scene.history.index[name]
        for name, begin_s in since_s.items()
        if view.scene.time_s - begin_s >= REACTION_S
    ]
    brakings = {row: _braking(view, row) for row in rows}
    return [
        Manoeuvre(WAITS, row, view.ways[row], SpeedProfile(then_mps2=-braking))
        for row, braking in brakings.items()
        if braking > 0.0
    ]


def _is_blocked(view: SituationView, row: int, for_s: float) -> bool:
    """Return whether the target blocks the way of *row*, which it has done *for_s* so far."""
    side_m = _REDUCED_SIDE_M if for_s >= _REDUCED_AFTER_S else _SIDE_M
    gap, _, across = _gap_ahead(view, row, view.scene.target, side_m)
    return bool(np.isfinite(gap)) and abs(across) <= _MAX_LATERAL_MPS


def _has_line_before(view: SituationView, row: int, gap_m: float) -> bool:
    """Return whether *row* comes to a line where it may have to stop within *gap_m*."""
    half_length = 0.5 * float(view.size(row)[0])
    lines = ((line_m - half_length, link) for line_m, link in view.ways[row].links)
    return any(0.0 < line < gap_m and _may_stop_at(view.signal(link), link.yields) for line, link in lines)


def _is_leader(view: SituationView, row: int) -> bool:
    """Return whether the target is on a lane that *row* will drive."""
    return view.target is not None and view.target.way.present_lane in view.ways[row].lane.lanes


def _may_stop_at(signal: str, yields: bool) -> bool:
    """Return whether SUMO's driver may have to stop at a line with this signal."""
    return signal != PROTECTED_GREEN if signal else yields


def _braking(view: SituationView, row: int) -> float:
    """Return the braking with which *row* stops before the target and all else on its way; 0: leave it to SUMO."""
    gap, along, _ = _gap_ahead(view, row, view.scene.target, _REDUCED_SIDE_M)
    if not np.isfinite(gap):
        gap, along, _ = _gap_ahead(view, row, view.scene.target, _SIDE_M)
    if _has_line_before(view, row, gap):
        return 0.0
    speed, is_leader = view.speed(row), _is_leader(view, row)
    hold_within = _MIN_SUMO_GAP_M if is_leader else _STOP_BEFORE_M + _HOLD_WITHIN_M
    if speed < _STANDING_MPS and gap < hold_within and along < _STANDING_MPS:
        return _USUAL_BRAKING_MPS2
    for_target = _needed_mps2(speed, gap, along)
    if _is_left_to_sumo(view, row, gap, along, is_leader):
        return 0.0
    others = (
        other for other in [*view.ways, *view.off_lane_rows.tolist()] if other not in (row, view.scene.target)
    )
    gaps = (_gap_ahead(view, row, other, _REDUCED_SIDE_M) for other in others)
    for_others = max((_needed_mps2(view.speed(row), gap, along) for gap, along, _ in gaps), default=0.0)
    return min(max(for_target, for_others, _MIN_BRAKING_MPS2), _MAX_BRAKING_MPS2)


def _is_left_to_sumo(view: SituationView, row: int, gap_m: float, along_mps: float, is_leader: bool) -> bool:
    """Return whether *row* can still stop gently at the next plan, however SUMO drives it until then.

    If the target is its leader, SUMO may brake harder for it.
    """
    speed, gain = view.speed(row), _SUMO_ACCEL_MPS2 * _NEXT_PLAN_S
    heeds_leader = (
        view.speed_gain_mps2(row) <= 0.0 or _needed_mps2(speed, gap_m, along_mps) < _USUAL_BRAKING_MPS2
    )
    follows = is_leader and heeds_leader and gap_m >= _MIN_SUMO_GAP_M
    next_mps, limit = (speed, _SUMO_MISSES_MPS2) if follows else (speed + gain, _USUAL_BRAKING_MPS2)
    closing = 0.5 * (speed + next_mps) - max(along_mps, 0.0)
    return _needed_mps2(next_mps, gap_m - _NEXT_PLAN_S * max(closing, 0.0), along_mps) < limit


def _needed_mps2(speed_mps: float, gap_m: float, along_mps: float) -> float:
    """Return the braking that keeps ``_STOP_BEFORE_M`` to an obstacle *gap_m* ahead that moves on at *along_mps*."""
    closing = speed_mps - max(along_mps, 0.0)
    return 0.5 * closing**2 / max(gap_m - _STOP_BEFORE_M, 0.1) if closing > 0.0 else 0.0


def _gap_ahead(view: SituationView, row: int, other: int, side_m: float) -> tuple[float, float, float]:
    """Return the gap from the front of *row* to the box of *other* on its way, and the speeds of *other*.

    These are its speeds along and across the way. The gap is inf if the box is not on the way, which is as wide as
    *row* and *side_m* more on either side.
    """
    history, way = view.scene.history, view.ways[row]
    length, width = view.size(row).tolist()
    yaw = float(history.yaw_rad[other, -1])
    heading = unit(np.array(yaw))
    axes = np.array([heading, [-heading[1], heading[0]]])
    outline = history.xy_m[other, -1] + (_OUTLINE * view.size(other)) @ axes
    s, left = way.line.project(outline)
    own_left = way.lane.offset_m
    is_beside = np.maximum(left - max(own_left, 0.0), min(own_left, 0.0) - left) > 0.5 * width + side_m
    gap = s - way.lane.s_m - 0.5 * length
    is_on_way = ~is_beside & (gap > -0.5 * side_m)
    if not is_on_way.any():
        return np.inf, 0.0, 0.0
    nearest = float(gap[is_on_way].min())
    _, way_yaw = way.line.at(np.array(way.lane.s_m + 0.5 * length + nearest))
    speed, angle = view.speed(other), yaw - float(way_yaw)
    return max(nearest, 0.0), speed * float(np.cos(angle)), speed * float(np.sin(angle))
