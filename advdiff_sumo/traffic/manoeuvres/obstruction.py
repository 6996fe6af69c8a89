"""Whose way the target's box blocks, although SUMO does not take it for their leader: they see it, and stop short.

SUMO's drivers look along lanes: a vehicle that stands across theirs, or beside its own, is none that they follow. On
their own lane they are left to SUMO until they would have to brake harder than its drivers ever do for a leader, or
gain speed towards one that they ought to brake for.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN
from advdiff_sumo.traffic.manoeuvres.answers import REACTION_S
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile

WAITS = "waits"
"""What somebody does whose way the target blocks."""
_ASIDE_M, _CAREFULLY_M = 0.25, 0.05
"""Room on either side of a box on its way; and of one that has waited for ``_PASSES_AFTER_S``."""
_PASSES_AFTER_S = 8.0
_BEGINS_MPS2, _HARDEST_MPS2 = 2.5, 8.5
_MISSED_MPS2, _NEXT_S = 5.0, 0.5
"""Braking, at the next plan, that tells that SUMO does not follow the target: its drivers brake with 4.5 m/s²."""
_GAINS_MPS2, _HOLDS_MPS2 = 2.6, 0.5
"""How fast SUMO's drivers gain speed, and the least braking of who is not to."""
_BEFORE_M, _STAYS_M, _HELD_MPS = 1.0, 2.0, 0.3
"""Who is slower so close to who is as slow is held there."""
_CLOSE_M = 2.0
"""Closer than this nobody stands behind a leader of SUMO's."""
_ACROSS_MPS = 1.0
_EDGE: FloatArray = np.linspace(-0.5, 0.5, 9)
_SIDE: FloatArray = np.full_like(_EDGE, 0.5)
_OUTLINE: FloatArray = np.concatenate(
    [np.stack(pair, -1) for pair in ((_EDGE, _SIDE), (_EDGE, -_SIDE), (_SIDE, _EDGE), (-_SIDE, _EDGE))]
)
"""(36, 2) points on the outline of a box of length and width 1."""


def blocked_since(view: SituationView, since_s: Mapping[str, float]) -> Mapping[str, float]:
    """Return id → since when each has had the target's box on its way."""
    now, ids = view.scene.time_s, view.scene.history.ids
    return {
        ids[row]: since_s.get(ids[row], now)
        for row in view.movable
        if row != view.scene.target and _is_blocked(view, row, now - since_s.get(ids[row], now))
    }


def waiting_manoeuvres(view: SituationView, since_s: Mapping[str, float]) -> list[Manoeuvre]:
    """Return how those brake, or stand, whose way has been blocked for their reaction time, where they have to.

    Before a line where it may have to stop nobody is taken from SUMO.

    Args:
        view: the scene.
        since_s: of :func:`blocked_since`.
    """
    rows = [
        view.scene.history.index[name] for name, at in since_s.items() if view.scene.time_s - at >= REACTION_S
    ]
    brakings = {row: _braking(view, row) for row in rows}
    return [
        Manoeuvre(WAITS, row, view.ways[row], SpeedProfile(then_mps2=-braking))
        for row, braking in brakings.items()
        if braking > 0.0
    ]


def _is_blocked(view: SituationView, row: int, for_s: float) -> bool:
    aside = _CAREFULLY_M if for_s >= _PASSES_AFTER_S else _ASIDE_M
    gap, _, across = _ahead(view, row, view.scene.target, aside)
    return bool(np.isfinite(gap)) and abs(across) <= _ACROSS_MPS


def _has_line_before(view: SituationView, row: int, gap_m: float) -> bool:
    """Return whether *row* comes to a line where it may have to stop within *gap_m*."""
    front = 0.5 * float(view.size(row)[0])
    lines = ((reach - front, link) for reach, link in view.ways[row].links)
    return any(0.0 < line < gap_m and _may_stop_at(view.signal(link), link.yields) for line, link in lines)


def _is_leader(view: SituationView, row: int) -> bool:
    """Return whether the target is on a lane that *row* is going to drive."""
    return view.target is not None and view.target.way.present_lane in view.ways[row].lane.lanes


def _may_stop_at(signal: str, yields: bool) -> bool:
    """Return whether SUMO's driver may have to stop at a line, where it is not taken from it."""
    return signal != PROTECTED_GREEN if signal else yields


def _braking(view: SituationView, row: int) -> float:
    """Return the braking with which *row* stops short of the target and of all else on its way; 0: left to SUMO."""
    gap, along, _ = _ahead(view, row, view.scene.target, _CAREFULLY_M)
    if not np.isfinite(gap):
        gap, along, _ = _ahead(view, row, view.scene.target, _ASIDE_M)
    if _has_line_before(view, row, gap):
        return 0.0
    speed, is_leader = view.speed(row), _is_leader(view, row)
    stays = _CLOSE_M if is_leader else _BEFORE_M + _STAYS_M
    if speed < _HELD_MPS and gap < stays and along < _HELD_MPS:
        return _BEGINS_MPS2
    needed = _needed_mps2(speed, gap, along)
    if _is_left_to_sumo(view, row, gap, along, is_leader):
        return 0.0
    others = (
        other for other in [*view.ways, *view.off_lane_rows.tolist()] if other not in (row, view.scene.target)
    )
    places = (_ahead(view, row, other, _CAREFULLY_M) for other in others)
    worst = max((_needed_mps2(view.speed(row), gap, along) for gap, along, _ in places), default=0.0)
    return min(max(needed, worst, _HOLDS_MPS2), _HARDEST_MPS2)


def _is_left_to_sumo(view: SituationView, row: int, gap_m: float, along_mps: float, is_leader: bool) -> bool:
    """Return whether *row* still stops gently at the next plan, however SUMO drives it; a leader it may brake for."""
    speed, gained = view.speed(row), _GAINS_MPS2 * _NEXT_S
    heeds = view.speed_gain_mps2(row) <= 0.0 or _needed_mps2(speed, gap_m, along_mps) < _BEGINS_MPS2
    follows = is_leader and heeds and gap_m >= _CLOSE_M
    then, limit = (speed, _MISSED_MPS2) if follows else (speed + gained, _BEGINS_MPS2)
    closing = 0.5 * (speed + then) - max(along_mps, 0.0)
    return _needed_mps2(then, gap_m - _NEXT_S * max(closing, 0.0), along_mps) < limit


def _needed_mps2(speed_mps: float, gap_m: float, along_mps: float) -> float:
    """Return the braking that keeps ``_BEFORE_M`` behind somebody *gap_m* ahead who goes on at *along_mps*."""
    closing = speed_mps - max(along_mps, 0.0)
    return 0.5 * closing**2 / max(gap_m - _BEFORE_M, 0.1) if closing > 0.0 else 0.0


def _ahead(view: SituationView, row: int, other: int, aside_m: float) -> tuple[float, float, float]:
    """Return the gap from the front of *row* to the box of *other* on its way, and that one's speeds along and across.

    The gap is inf where the box is not on the way, as wide as *row* and *aside_m* on either side.
    """
    now, way = view.scene.history, view.ways[row]
    length, width = view.size(row).tolist()
    yaw = float(now.yaw_rad[other, -1])
    facing = unit(np.array(yaw))
    turned = np.array([facing, [-facing[1], facing[0]]])
    outline = now.xy_m[other, -1] + (_OUTLINE * view.size(other)) @ turned
    s, left = way.line.project(outline)
    own = way.lane.offset_m
    beside = np.maximum(left - max(own, 0.0), min(own, 0.0) - left) > 0.5 * width + aside_m
    gap = s - way.lane.s_m - 0.5 * length
    met = ~beside & (gap > -0.5 * aside_m)
    if not met.any():
        return np.inf, 0.0, 0.0
    first = float(gap[met].min())
    _, along = way.line.at(np.array(way.lane.s_m + 0.5 * length + first))
    speed, angle = view.speed(other), yaw - float(along)
    return max(first, 0.0), speed * float(np.cos(angle)), speed * float(np.sin(angle))
