"""Which vehicles must wait at their line until the target, which has the right of way there, has passed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN
from advdiff_sumo.maps.junction_priority import priority_links
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.priority_traffic import (
    CAREFUL_STOP_MPS2,
    conflict_points_m,
)
from advdiff_sumo.traffic.manoeuvres.required_braking import HURRYING_MPS2
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.planning.futures import STANDS_MPS, Futures

_BEFORE_LINE_M = 0.5  # gap from the front of a waiting vehicle to its line
_SPARE_S, _SPARE_M = 1.0, 1.5
"""Time and distance that a vehicle must leave to the target at the conflict point."""
_AT_LINE_M = 15.0  # a vehicle this near to its line has come to the junction


@dataclass(frozen=True)
class _Entry:
    """How a vehicle drives over the junction that it is on or comes to next.

    Attributes:
        link: the connection.
        line_m: distance from the box centre to its stop line; negative beyond it.
        speed_mps: present speed.
        half_m: half the length of the vehicle.
    """

    link: Link
    line_m: float
    speed_mps: float
    half_m: float

    @property
    def room_m(self) -> float:
        """Distance until the front is where it waits, before the line."""
        return self.line_m - self.half_m - _BEFORE_LINE_M

    @property
    def is_too_late(self) -> bool:
        """Whether it is over the line, or braking with 4 m/s² could not stop it before the line."""
        room_m = max(self.room_m, 0.5 * _BEFORE_LINE_M)
        return self.is_over or self.speed_mps**2 > 2.0 * CAREFUL_STOP_MPS2 * room_m

    @property
    def is_over(self) -> bool:
        """Whether its front is over the line."""
        return self.line_m < self.half_m


def waiting_lines_m(view: SituationView, rows: Sequence[int], futures: Futures) -> FloatArray:
    """Return (N,) how far each vehicle may drive before the target has passed; inf if it need not wait.

    A vehicle waits if it must yield to the target by the net's rules or, where these rank neither, if the target is
    over its line already. It need not wait if

    - its plan takes it past the conflict point a second before a target that hurries can be there,
    - it is over its own line, or would have to brake harder than 4 m/s²,
    - the target has a red light, follows a vehicle that will still be in its way, or arrives after the plans end, or
    - the target has stood for its whole history and must yield to another vehicle itself.

    Args:
        view: the scene.
        rows: N rows of the scene.
        futures: the plans of *rows*.
    """
    lines_m = np.full(len(rows), np.inf)
    target = _entry(view, view.scene.target)
    if target is None or not _target_may_go(view, target):
        return lines_m
    driven_m = futures.travelled_m()
    for k, row in enumerate(rows):
        own = _entry(view, row)
        if own is None or own.is_too_late or not _must_yield(view, own, target):
            continue
        if _conflicts(view, own, target, driven_m[k], futures.dt_s):
            lines_m[k] = max(own.room_m, 0.0)
    return lines_m


def _entry(view: SituationView, row: int) -> _Entry | None:
    """Return how *row* drives over its junction; None if there is none on its way."""
    way = view.ways.get(row)
    if way is None:
        return None
    lane, size = way.present_lane, view.size(row)
    link = view.road.link_of_internal_lane.get(lane.id)
    if link is not None:
        driven_lanes = link.via[: link.via.index(lane.id)]
        line_m = -way.lane.s_m - sum(view.road.lanes[name].length_m for name in driven_lanes)
    elif way.links:
        line_m, link = way.links[0]
    else:
        return None
    return _Entry(link, line_m, view.speed(row), 0.5 * float(size[0]))


def _target_may_go(view: SituationView, target: _Entry) -> bool:
    """Return whether only vehicles that must yield to the target could keep it from going on."""
    if view.is_red(target.link) or not view.is_clear_on_arrival(target.line_m):
        return False
    history, row = view.scene.history, view.scene.target
    if (np.abs(history.speed_mps[row][history.valid[row]]) > STANDS_MPS).any():
        return True
    prior_links = priority_links(view.road, target.link, view.scene.signals)
    others = (_entry(view, other) for other in view.ways if other != row)
    return not any(
        other.link in prior_links and other.line_m < _AT_LINE_M for other in others if other is not None
    )


def _must_yield(view: SituationView, own: _Entry, target: _Entry) -> bool:
    """Return whether a vehicle before its line must let the target pass: by the net's rules, or as it comes later."""
    if own.link == target.link or own.link.junction_id != target.link.junction_id:
        return False
    if view.signal(own.link) == PROTECTED_GREEN:
        return False
    yields = view.road.must_yield(own.link, target.link), view.road.must_yield(target.link, own.link)
    return target.is_over if yields[0] == yields[1] else yields[0]


def _conflicts(view: SituationView, own: _Entry, target: _Entry, driven_m: FloatArray, dt_s: float) -> bool:
    """Return whether a vehicle that drives *driven_m* (T + 1,) is still at the conflict point as the target arrives."""
    points = conflict_points_m(view.road, target.link, own.link)
    if points is None:
        return False
    target_m, own_m = target.line_m + points[0], own.line_m + points[1]
    if target_m + target.half_m + _SPARE_M < 0.0:
        return False
    limit = view.road.lanes[target.link.from_lane].speed_mps
    arrival_s = _earliest_s(target_m - target.half_m - _SPARE_M, target.speed_mps, limit)
    has_passed = driven_m > own_m + own.half_m + _SPARE_M
    leaves_s = dt_s * float(has_passed.argmax()) if has_passed.any() else np.inf
    return arrival_s < min(dt_s * (len(driven_m) - 1), leaves_s + _SPARE_S)


def _earliest_s(ahead_m: float, speed_mps: float, limit_mps: float) -> float:
    """Return when a vehicle that hurries is *ahead_m* further on."""
    fastest = max(speed_mps, limit_mps)
    gaining_m = (fastest**2 - speed_mps**2) / (2.0 * HURRYING_MPS2)
    if ahead_m <= gaining_m:
        reached = float(np.sqrt(speed_mps**2 + 2.0 * HURRYING_MPS2 * max(ahead_m, 0.0)))
        return (reached - speed_mps) / HURRYING_MPS2
    return (fastest - speed_mps) / HURRYING_MPS2 + (ahead_m - gaining_m) / fastest
