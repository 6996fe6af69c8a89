"""Ordinary driving before an attack: the target has had the attacker in view for some seconds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from advdiff_sumo.traffic.manoeuvres.free_speed import FINE_TIMES_S
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.priority_traffic import conflict_points_m
from advdiff_sumo.traffic.manoeuvres.repertoire import SLOW_ENTRIES, crossing_links
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

ORDINARY_DRIVING_S, SHORT_VIEW_S = 3.0, 2.0
"""For so long the target drives, and has somebody in view, who drives as everybody does before it asks anything of it;
and has somebody in view who comes to cross its way, or is slow on the lane beside, where it has been seen from afar."""
_ANSWERS_S = 2.5
"""So long before they would meet the target has to begin to give way to somebody who crosses."""
_SLACK_S = 1e-6


def in_view_since(view: SituationView, since_s: Mapping[str, float]) -> Mapping[str, float]:
    """Return id → since when everybody near has been in view, out of the same for the plan before."""
    now, ids = view.scene.time_s, view.scene.history.ids
    return {ids[row]: since_s.get(ids[row], now) for row in view.ways}


def response_time_s(view: SituationView, manoeuvre: Manoeuvre) -> float:
    """Return how long from now the target has to begin to answer *manoeuvre*, if it goes on until then."""
    if manoeuvre.kind == "crossing":
        return max(_arrives_s(view, manoeuvre) - _ANSWERS_S, 0.0)
    now = view.scene.history.xy_m[manoeuvre.row, -1]
    return manoeuvre.perceivable_s(now) if manoeuvre.kind in SLOW_ENTRIES else manoeuvre.enters_s(now)


def is_seen_long_enough(view: SituationView, manoeuvre: Manoeuvre, since_s: Mapping[str, float]) -> bool:
    """Return whether the target has been driving, with the other in view, for long enough when it must respond."""
    if manoeuvre.sets_up:
        return True
    now = view.scene.time_s
    crosses = manoeuvre.kind == "crossing"
    bears_s = _arrives_s(view, manoeuvre) if crosses else response_time_s(view, manoeuvre)
    in_view_s = now - since_s.get(view.scene.history.ids[manoeuvre.row], now)
    longest_s = SHORT_VIEW_S if crosses or manoeuvre.kind in SLOW_ENTRIES else ORDINARY_DRIVING_S
    return now + bears_s >= ORDINARY_DRIVING_S - _SLACK_S and in_view_s + bears_s >= longest_s - _SLACK_S


def _arrives_s(view: SituationView, manoeuvre: Manoeuvre) -> float:
    """Return when the target would be where *manoeuvre* crosses its way; 0 where it is on that junction."""
    target, links = view.target, crossing_links(view, manoeuvre.row)
    if target is None or links is None:
        return 0.0
    own, targets = links
    reach = next((reach for reach, link in target.way.links if link is targets), None)
    places = conflict_points_m(view.road, targets, own)
    if reach is None:
        return 0.0
    arrives_s = target.arrival_s(reach + (places[0] if places is not None else 0.0))
    return arrives_s if np.isfinite(arrives_s) else float(FINE_TIMES_S[-1])
