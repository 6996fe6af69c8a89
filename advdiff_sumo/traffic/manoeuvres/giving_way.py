"""Who has to wait at its line until the target, which has the right of way there, has passed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN
from advdiff_sumo.maps.lanes import Link
from advdiff_sumo.traffic.manoeuvres.answers import HURRYING_MPS2
from advdiff_sumo.traffic.manoeuvres.priority_traffic import (
    CAREFUL_STOP_MPS2,
    conflict_points_m,
    priority_links,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.planning.futures import STANDS_MPS, Futures

_BEFORE_LINE_M = 0.5
_SPARE_S, _ASIDE_M = 1.0, 1.5
_AT_LINE_M = 15.0


@dataclass(frozen=True)
class _Entry:
    """The way of a vehicle over the junction that it is on or comes to next.

    Attributes:
        link: the connection.
        line_m: distance from the box centre to its stop line; negative beyond it.
        speed_mps: now.
        half_m: half the length of the vehicle.
    """

    link: Link
    line_m: float
    speed_mps: float
    half_m: float

    @property
    def room_m(self) -> float:
        """Distance that the front may drive until it is at its place before the line."""
        return self.line_m - self.half_m - _BEFORE_LINE_M

    @property
    def is_late(self) -> bool:
        """Whether it is over the line, or could not stop before it by braking with 4 m/s²."""
        room_m = max(self.room_m, 0.5 * _BEFORE_LINE_M)
        return self.is_over or self.speed_mps**2 > 2.0 * CAREFUL_STOP_MPS2 * room_m

    @property
    def is_over(self) -> bool:
        """Whether its front is over the line."""
        return self.line_m < self.half_m


def waiting_lines_m(view: SituationView, rows: Sequence[int], futures: Futures) -> FloatArray:
    """Return (N,) how far each may drive before the target has passed; inf where it need not wait.

    Who has to give way to the target, by the net's rules or, where these say nothing, as it is over its line already,
    waits; unless its plan takes it past the place where they meet a second before the target, were it to hurry, can be
    there; or it is over its own line; or it would have to brake harder than 4 m/s². Nobody waits for a target that has
    a red light, that follows somebody who will still be in its way, that is not there before the plans end, or that has
    stood for its whole history and has to let somebody else pass itself.

    Args:
        view: the scene.
        rows: N rows of the scene.
        futures: their plans.
    """
    lines = np.full(len(rows), np.inf)
    target = _entry(view, view.scene.target)
    if target is None or not _may_go(view, target):
        return lines
    driven = futures.travelled_m()
    for k, row in enumerate(rows):
        own = _entry(view, row)
        if own is None or own.is_late or not _gives_way(view, own, target):
            continue
        if _gets_in_the_way(view, own, target, driven[k], futures.dt_s):
            lines[k] = max(own.room_m, 0.0)
    return lines


def _entry(view: SituationView, row: int) -> _Entry | None:
    way = view.ways.get(row)
    if way is None:
        return None
    lane, size = way.present_lane, view.size(row)
    link = view.road.link_over.get(lane.id)
    if link is not None:
        behind = link.via[: link.via.index(lane.id)]
        line_m = -way.lane.s_m - sum(view.road.lanes[name].length_m for name in behind)
    elif way.links:
        line_m, link = way.links[0]
    else:
        return None
    return _Entry(link, line_m, view.speed(row), 0.5 * float(size[0]))


def _may_go(view: SituationView, target: _Entry) -> bool:
    """Return whether nothing but who has to give way to it keeps the target from going on."""
    if view.is_red(target.link) or not view.is_clear_on_arrival(target.line_m):
        return False
    history, row = view.scene.history, view.scene.target
    if (np.abs(history.speed_mps[row][history.valid[row]]) > STANDS_MPS).any():
        return True
    first = priority_links(view, target.link)
    others = (_entry(view, other) for other in view.ways if other != row)
    return not any(other.link in first and other.line_m < _AT_LINE_M for other in others if other is not None)


def _gives_way(view: SituationView, own: _Entry, target: _Entry) -> bool:
    """Return whether who is before its line has to let the target pass: by the net's rules, or as it comes later."""
    if own.link == target.link or own.link.junction_id != target.link.junction_id:
        return False
    if view.signal(own.link) == PROTECTED_GREEN:
        return False
    yields = view.road.must_yield(own.link, target.link), view.road.must_yield(target.link, own.link)
    return target.is_over if yields[0] == yields[1] else yields[0]


def _gets_in_the_way(
    view: SituationView, own: _Entry, target: _Entry, driven_m: FloatArray, dt_s: float
) -> bool:
    """Return whether who drives *driven_m* (T + 1,) is still where the ways meet when the target comes there."""
    places = conflict_points_m(view.road, target.link, own.link)
    if places is None:
        return False
    ahead_m, own_m = target.line_m + places[0], own.line_m + places[1]
    if ahead_m + target.half_m + _ASIDE_M < 0.0:
        return False
    limit = view.road.lanes[target.link.from_lane].speed_mps
    arrives_s = _soonest_s(ahead_m - target.half_m - _ASIDE_M, target.speed_mps, limit)
    past = driven_m > own_m + own.half_m + _ASIDE_M
    leaves_s = dt_s * float(past.argmax()) if past.any() else np.inf
    return arrives_s < min(dt_s * (len(driven_m) - 1), leaves_s + _SPARE_S)


def _soonest_s(ahead_m: float, speed_mps: float, limit_mps: float) -> float:
    """Return when somebody who hurries is *ahead_m* further on."""
    fastest = max(speed_mps, limit_mps)
    gains_m = (fastest**2 - speed_mps**2) / (2.0 * HURRYING_MPS2)
    if ahead_m <= gains_m:
        reached = float(np.sqrt(speed_mps**2 + 2.0 * HURRYING_MPS2 * max(ahead_m, 0.0)))
        return (reached - speed_mps) / HURRYING_MPS2
    return (fastest - speed_mps) / HURRYING_MPS2 + (ahead_m - gains_m) / fastest
