"""Which manoeuvres begin beside those under way: the best that go together, that a follower can answer, and lawful."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.agenda import TURN_S, has_red_ahead
from advdiff_sumo.traffic.manoeuvres.choice import Chosen, rank
from advdiff_sumo.traffic.manoeuvres.commitments import LEADER_KINDS, PATIENCE_S, SUPPORT_KINDS, Commitments
from advdiff_sumo.traffic.manoeuvres.continuation import still_lawful
from advdiff_sumo.traffic.manoeuvres.follower import FOLLOWS, braking_behind
from advdiff_sumo.traffic.manoeuvres.graded import with_braking, with_severity
from advdiff_sumo.traffic.manoeuvres.hidden_stop import hard_stop_in_company
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.oncoming import filter_oncoming
from advdiff_sumo.traffic.manoeuvres.ordinary_driving import is_seen_long_enough, response_time_s
from advdiff_sumo.traffic.manoeuvres.plan_licence import CARELESS_ALLOWS, plan_breaches
from advdiff_sumo.traffic.manoeuvres.repertoire import DOUBLE
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import PROPOSALS, can_begin_later

_PATIENCE = ((PATIENCE_S, 0.4),)
"""Until when (s) an episode waits for a better moment than one of so little merit."""
_LEADER_PATIENCE = ((TURN_S, 0.7), (4.0 * TURN_S, 0.4))
"""The same for a leader that lets the target close up, and which no red light stops soon."""
_NOW_S = 0.5
_PROPOSED = {**PROPOSALS, DOUBLE: hard_stop_in_company}
_TRIED = 4
"""Manoeuvres that are checked in full, best first."""


def begin(
    view: SituationView, kept: Commitments, going: Sequence[Manoeuvre], room: int, licence: Licence | None
) -> list[Chosen]:
    """Return the best new manoeuvres beside those *going* on, one a vehicle, one that crosses, at most *room*."""
    names, now = view.scene.history.ids, view.scene.time_s
    busy = {m.row for m in going}
    busy |= {r for r in view.movable if kept.standing.is_passive(names[r])}
    free = [r for r in view.movable if r not in busy and kept.rested_s.get(names[r], -1.0) <= now]
    wanted = kept.startable_kinds(view)
    possible = [m for row in free for kind in wanted for m in _PROPOSED[kind](view, row)]
    possible = list(filter_oncoming(view, possible, kept.stage.only_oncoming))
    possible = [m for m in possible if not (m.sets_up and names[m.row] in kept.standing.names)]
    proposals = [
        m for m in with_severity(view, possible, kept.intensity) if is_seen_long_enough(view, m, kept.since_s)
    ]
    out: list[Chosen] = []
    ranked = rank(view, proposals, kept.weights, licence, kept.intensity, preference=kept.preference)
    patience = _LEADER_PATIENCE if kept.agenda.order and not has_red_ahead(view) else _PATIENCE
    least = {kind: _least(patience if kind in LEADER_KINDS else _PATIENCE, now) for kind in kept.weights}
    worthy = [one for one in ranked if one.manoeuvre.sets_up or one.merit >= least[one.manoeuvre.kind]]
    ready = [one for one in worthy if not can_begin_later(view, one.manoeuvre, one.needed_mps2, licence)]
    for chosen in ready[:_TRIED]:
        others = (*going, *(one.manoeuvre for one in out))
        fits = all(_go_together(chosen.manoeuvre, other) for other in others)
        if len(out) < room and fits and _spares_follower(view, chosen) and _passes(view, chosen, licence):
            driven = with_braking(chosen.manoeuvre, kept.intensity.braking_mps2)
            out.append(replace(chosen, manoeuvre=driven))
    return out


def _least(patience: Sequence[tuple[float, float]], now_s: float) -> float:
    """Return the merit below which an episode waits for a better moment."""
    return next((merit for until_s, merit in patience if now_s < until_s), 0.0)


def _go_together(one: Manoeuvre, other: Manoeuvre) -> bool:
    """Return whether both can be driven: two that cross would meet each other, and a leader would stop the target."""
    if one.row == other.row or one.kind == other.kind == "crossing":
        return False
    return "crossing" not in (one.kind, other.kind) or not {one.kind, other.kind} & LEADER_KINDS


def _spares_follower(view: SituationView, chosen: Chosen) -> bool:
    """Return whether who follows the target can brake for it, too."""
    behind = view.follower
    if behind is None or behind == chosen.manoeuvre.row or chosen.manoeuvre.sets_up:
        return True
    return braking_behind(view, behind, response_time_s(view, chosen.manoeuvre)) is not None


def follower_braking(
    view: SituationView, driven: Sequence[Manoeuvre], fresh: Sequence[Manoeuvre], licence: Licence | None
) -> list[Manoeuvre]:
    """Return what who follows the target drives where it has to answer now, if it may be moved and does not yet.

    It answers one of *fresh*, or of those *driven* somebody who crosses once it is near.
    """
    row = view.follower
    if row not in view.movable or any(m.row == row or m.kind == FOLLOWS for m in driven):
        return []
    attacks = [m for m in driven if not m.sets_up and (m in fresh or m.kind == "crossing")]
    times_s = [(m.kind, response_time_s(view, m)) for m in attacks if m.kind not in SUPPORT_KINDS]
    soon_s = [time_s for kind, time_s in times_s if kind != "crossing" or time_s < _NOW_S]
    brakes = braking_behind(view, row, min(soon_s)) if soon_s else None
    return [brakes] if brakes is not None and still_lawful(view, brakes, licence) else []


def _passes(view: SituationView, chosen: Chosen, licence: Licence | None) -> bool:
    """Return whether the breach rules of the verdict find nothing in the plan of *chosen*."""
    if licence is None or chosen.manoeuvre.sets_up:
        return True
    future = chosen.futures
    rows = [chosen.manoeuvre.row]
    broken = plan_breaches(view, rows, future.xy_m, future.yaw_rad, future.speed_mps)[0]
    return not (broken - (CARELESS_ALLOWS if licence is not LAWFUL else frozenset()))
