"""Ordinary driving before an attack: the target must have had the attacker in view for some seconds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.priority_traffic import conflict_points_m
from advdiff_sumo.traffic.manoeuvres.repertoire import SLOW_ENTRIES, crossing_links
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

ORDINARY_DRIVING_S, SHORT_VIEW_S = 3.0, 2.0
"""For so long the target drives, with the other vehicle in view, before it must respond to it. The shorter time is for
vehicles that cross its way or are slow on the lane beside, which are visible from afar."""
_CROSSING_RESPONSE_S = 2.5
"""The target must begin to yield so long before it would meet a crossing vehicle."""
_TOLERANCE_S = 1e-6


def in_view_since(view: SituationView, since_s: Mapping[str, float]) -> Mapping[str, float]:
    """Return id → time since when each vehicle near has been in view, given *since_s* of the plan before."""
    now, ids = view.scene.time_s, view.scene.history.ids
    return {ids[row]: since_s.get(ids[row], now) for row in view.ways}


def response_time_s(view: SituationView, manoeuvre: Manoeuvre) -> float:
    """Return how long from now the target must begin to respond to *manoeuvre*, if it does nothing until then."""
    if manoeuvre.kind == "crossing":
        return max(_meets_s(view, manoeuvre) - _CROSSING_RESPONSE_S, 0.0)
    xy_m = view.scene.history.xy_m[manoeuvre.row, -1]
    return manoeuvre.perceivable_s(xy_m) if manoeuvre.kind in SLOW_ENTRIES else manoeuvre.enters_s(xy_m)


def is_seen_long_enough(view: SituationView, manoeuvre: Manoeuvre, since_s: Mapping[str, float]) -> bool:
    """Return whether the target has been driving, with the other in view, for long enough when it must respond.

    *since_s* is that of :func:`in_view_since`.
    """
    if manoeuvre.is_positioning:
        return True
    now = view.scene.time_s
    crosses = manoeuvre.kind == "crossing"
    wait_s = _meets_s(view, manoeuvre) if crosses else response_time_s(view, manoeuvre)
    in_view_s = now - since_s.get(view.scene.history.ids[manoeuvre.row], now)
    least_s = SHORT_VIEW_S if crosses or manoeuvre.kind in SLOW_ENTRIES else ORDINARY_DRIVING_S
    return now + wait_s >= ORDINARY_DRIVING_S - _TOLERANCE_S and in_view_s + wait_s >= least_s - _TOLERANCE_S


def _meets_s(view: SituationView, manoeuvre: Manoeuvre) -> float:
    """Return when the target would be where *manoeuvre* crosses its way; 0 if it is on that junction."""
    target, links = view.target, crossing_links(view, manoeuvre.row)
    if target is None or links is None:
        return 0.0
    own_link, target_link = links
    line_m = next((line_m for line_m, link in target.way.links if link is target_link), None)
    points = conflict_points_m(view.road, target_link, own_link)
    if line_m is None:
        return 0.0
    meets_s = target.arrival_s(line_m + (points[0] if points is not None else 0.0))
    return meets_s if np.isfinite(meets_s) else float(FINE_TIMES_S[-1])
