"""Chooses the manoeuvres that begin: the best ones that are lawful, go together and let a follower stop in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.agenda import TURN_S, has_red_ahead
from advdiff_sumo.traffic.manoeuvres.blind_spot import blind_spot
from advdiff_sumo.traffic.manoeuvres.choice import Chosen, rank
from advdiff_sumo.traffic.manoeuvres.close_pass import close_pass
from advdiff_sumo.traffic.manoeuvres.commitments import LEADER_KINDS, PATIENCE_S, SUPPORT_KINDS, Commitments
from advdiff_sumo.traffic.manoeuvres.continuation import still_lawful
from advdiff_sumo.traffic.manoeuvres.follower import FOLLOWS, braking_behind
from advdiff_sumo.traffic.manoeuvres.hidden_stop import hard_stop_in_company
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.oncoming import suited_crossings
from advdiff_sumo.traffic.manoeuvres.ordinary_driving import is_seen_long_enough, response_time_s
from advdiff_sumo.traffic.manoeuvres.plan_breaches import CARELESS_ALLOWS, plan_breaches
from advdiff_sumo.traffic.manoeuvres.prescribed_severity import with_braking, with_severity
from advdiff_sumo.traffic.manoeuvres.repertoire import BESIDE_KINDS, BLIND_SPOT, CLOSE_PASSING, DOUBLE
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import PROPOSALS, can_begin_later

_MIN_MERITS = ((PATIENCE_S, 0.4),)
"""(time in the episode, merit below which a manoeuvre does not begin until then)."""
_MIN_LEADER_MERITS = ((TURN_S, 0.7), (4.0 * TURN_S, 0.4))
"""The same for a leader that lets the target close up, and that no red light will stop soon."""
_SOON_S = 0.5  # the follower brakes for a crossing vehicle when the target must respond within this time
_PROPOSALS = {**PROPOSALS, DOUBLE: hard_stop_in_company, CLOSE_PASSING: close_pass, BLIND_SPOT: blind_spot}
_NEEDS_NO_BRAKING = (*SUPPORT_KINDS, *BESIDE_KINDS)
_FULLY_CHECKED = 4  # number of manoeuvres that are checked in full, best first


def begin(
    view: SituationView, memory: Commitments, going: Sequence[Manoeuvre], room: int, licence: Licence | None
) -> list[Chosen]:
    """Return the best new manoeuvres beside those *going* on: one for a vehicle, one crossing, at most *room*."""
    names, now = view.scene.history.ids, view.scene.time_s
    busy = {m.row for m in going}
    busy |= {r for r in view.movable if memory.standing.is_passive(names[r])}
    free = [r for r in view.movable if r not in busy and memory.rested_s.get(names[r], -1.0) <= now]
    kinds = memory.startable_kinds(view)
    possible = [m for row in free for kind in kinds for m in _PROPOSALS[kind](view, row)]
    possible = list(suited_crossings(view, possible, memory.stage))
    possible = [m for m in possible if not (m.is_positioning and names[m.row] in memory.standing.names)]
    adapted = with_severity(view, possible, memory.intensity)
    proposals = [m for m in adapted if is_seen_long_enough(view, m, memory.since_s)]
    begun: list[Chosen] = []
    ranked = rank(view, proposals, memory.weights, licence, memory.intensity, preference=memory.preference)
    leader_merits = _MIN_LEADER_MERITS if memory.agenda.order and not has_red_ahead(view) else _MIN_MERITS
    least = {
        kind: _min_merit(leader_merits if kind in LEADER_KINDS else _MIN_MERITS, now)
        for kind in memory.weights
    }
    good = [c for c in ranked if c.manoeuvre.is_positioning or c.merit >= least[c.manoeuvre.kind]]
    spare_gap_m = memory.intensity.spare_gap_m
    ready = [c for c in good if not can_begin_later(view, c.manoeuvre, c.needed_mps2, licence, spare_gap_m)]
    for chosen in ready[:_FULLY_CHECKED]:
        others = (*going, *(c.manoeuvre for c in begun))
        fits = len(begun) < room and all(_go_together(chosen.manoeuvre, other) for other in others)
        if fits and _follower_can_stop(view, chosen) and _has_no_breach(view, chosen, licence):
            braked = with_braking(chosen.manoeuvre, memory.intensity.braking_mps2)
            begun.append(replace(chosen, manoeuvre=braked))
    return begun


def _min_merit(merits: Sequence[tuple[float, float]], now_s: float) -> float:
    """Return the merit below which an episode waits for a better moment."""
    return next((merit for until_s, merit in merits if now_s < until_s), 0.0)


def _go_together(first: Manoeuvre, second: Manoeuvre) -> bool:
    """Return whether both can be driven.

    Two crossings would collide, two leaders run into each other, and a leader would stop the target before a crossing.
    """
    kinds = {first.kind, second.kind}
    if first.row == second.row or kinds == {"crossing"} or kinds <= LEADER_KINDS:
        return False
    return "crossing" not in kinds or not kinds & LEADER_KINDS


def _follower_can_stop(view: SituationView, chosen: Chosen) -> bool:
    """Return whether the vehicle behind the target can brake in time, too."""
    behind, manoeuvre = view.follower, chosen.manoeuvre
    if behind in (None, manoeuvre.row) or manoeuvre.is_positioning or manoeuvre.kind in _NEEDS_NO_BRAKING:
        return True
    return braking_behind(view, behind, response_time_s(view, manoeuvre)) is not None


def follower_braking(
    view: SituationView, driven: Sequence[Manoeuvre], fresh: Sequence[Manoeuvre], licence: Licence | None
) -> list[Manoeuvre]:
    """Return the braking of the vehicle behind the target that must begin now, if it may be moved and does not brake.

    It brakes for the *fresh* ones among the manoeuvres *driven*, and for a crossing vehicle once that is near.
    """
    row = view.follower
    if row not in view.movable or any(m.row == row or m.kind == FOLLOWS for m in driven):
        return []
    attacks = [m for m in driven if not m.is_positioning and (m in fresh or m.kind == "crossing")]
    responses = [(m.kind, response_time_s(view, m)) for m in attacks if m.kind not in _NEEDS_NO_BRAKING]
    soon_s = [time_s for kind, time_s in responses if kind != "crossing" or time_s < _SOON_S]
    braking = braking_behind(view, row, min(soon_s)) if soon_s else None
    return [braking] if braking is not None and still_lawful(view, braking, licence) else []


def _has_no_breach(view: SituationView, chosen: Chosen, licence: Licence | None) -> bool:
    """Return whether the breach rules of the verdict find nothing in the plan of *chosen*."""
    if licence is None or chosen.manoeuvre.is_positioning:
        return True
    future = chosen.futures
    rows = [chosen.manoeuvre.row]
    breaches = plan_breaches(view, rows, future.xy_m, future.yaw_rad, future.speed_mps)[0]
    return not (breaches - (CARELESS_ALLOWS if licence is not LAWFUL else frozenset()))
