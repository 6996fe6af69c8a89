"""Manoeuvres over time: continues those that are lawful and useful, begins new ones, and inserts vehicles for them."""

from __future__ import annotations

from dataclasses import replace

from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.agenda import approaches_yield_line, is_possible
from advdiff_sumo.traffic.manoeuvres.beginning import begin, follower_braking
from advdiff_sumo.traffic.manoeuvres.close_pass import slow_leaders
from advdiff_sumo.traffic.manoeuvres.commitments import SUPPORT_KINDS, Commitment, Commitments
from advdiff_sumo.traffic.manoeuvres.company import company_manoeuvres
from advdiff_sumo.traffic.manoeuvres.continuation import continue_manoeuvres
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.obstruction import blocked_since, waiting_manoeuvres
from advdiff_sumo.traffic.manoeuvres.ordinary_driving import in_view_since
from advdiff_sumo.traffic.manoeuvres.repertoire import BESIDE_KINDS, DOUBLE, SLOW_ENTRIES
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_places import insert_slow_vehicle
from advdiff_sumo.traffic.manoeuvres.speed_profiles import PLAN_DT_S
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, insert_newcomers
from advdiff_sumo.traffic.manoeuvres.standing_traffic import QUEUE, StandingTraffic, insert_queue

_RETRY_S = 1.0
"""After this time a queue for which there was no room is tried again, farther on."""


def update_manoeuvres(
    view: SituationView, memory: Commitments, attackers: int, pause_s: float, licence: Licence | None = LAWFUL
) -> tuple[list[Manoeuvre], Commitments]:
    """Return the manoeuvres that are driven now, and the updated memory.

    Args:
        view: the scene.
        memory: memory of the plan before.
        attackers: most vehicles in a manoeuvre at a time.
        pause_s: rest of a vehicle after a manoeuvre.
        licence: what they may do; None: anything.
    """
    memory = replace(memory, agenda=memory.agenda.updated(view), since_s=in_view_since(view, memory.since_s))
    going, memory = continue_manoeuvres(view, memory, pause_s, licence)
    if licence is not None:
        memory = replace(memory, blocked_s=blocked_since(view, memory.blocked_s))
        busy = {m.row for m in going}
        going += [m for m in waiting_manoeuvres(view, memory.blocked_s) if m.row not in busy]
    room = attackers - sum(m.kind not in SUPPORT_KINDS for m in going)
    chosen = begin(view, memory, going, room, licence) if room > 0 else []
    features = {choice.manoeuvre.row: choice.features for choice in chosen}
    fresh = [choice.manoeuvre for choice in chosen]
    fresh += follower_braking(view, [*going, *fresh], fresh, licence)
    driven, names, now = [*going, *fresh], view.scene.history.ids, view.scene.time_s
    kinds, busy = memory.startable_kinds(view), {m.row for m in driven}
    company = company_manoeuvres(view, busy, licence) if DOUBLE in kinds else []
    roles = {names[m.row]: DOUBLE for m in company}
    leaders = slow_leaders(view, busy, licence) if any(kind in kinds for kind in BESIDE_KINDS) else []
    memory = replace(memory, company={**roles, **{names[m.row]: m.kind for m in leaders}})
    begun = {names[m.row]: _commitment(m, now, features.get(m.row, ())) for m in fresh}
    attackers_begun = {name for name, under_way in begun.items() if not under_way.is_positioning}
    standing = memory.standing.without(attackers_begun)
    return [*driven, *company, *leaders], replace(
        memory, active={**memory.active, **begun}, standing=standing
    )


def insert_vehicles(view: SituationView, memory: Commitments) -> tuple[tuple[Newcomer, ...], Commitments]:
    """Return the vehicles that are inserted now, for the manoeuvres that may begin, and the updated memory.

    Standing vehicles, and slow ones that a leader hides, are only in the memory.
    """
    memory = _update_standing(view, memory)
    busy = {under_way.kind for under_way in memory.active.values() if not under_way.is_positioning}
    if memory.stage.streams:
        busy -= {"crossing"}  # the next one of a stream comes while the others cross
    kinds = [kind for kind in memory.insertable_kinds(view) if kind not in busy]
    possible = "crossing" in kinds and is_possible(view, "crossing")
    if memory.agenda.prioritises_crossing and ("crossing" in busy or possible or approaches_yield_line(view)):
        # a leader would keep the target from the junction
        kinds = [kind for kind in kinds if kind == "crossing"]
    if QUEUE in kinds:
        standing, stage = insert_queue(view, memory.stage, memory.standing)
        memory = replace(memory, standing=standing, stage=stage)
        kinds = [] if standing.is_queue else kinds
    for kind in SLOW_ENTRIES:
        if kind in kinds:
            standing, stage = insert_slow_vehicle(view, memory.stage, memory.standing, kind)
            memory = replace(memory, standing=standing, stage=stage)
    newcomers, stage = insert_newcomers(view, memory.stage, kinds)
    hidden = tuple(newcomer for newcomer in newcomers if newcomer.is_hidden)
    if hidden:
        memory = replace(memory, standing=StandingTraffic("cut-out", hidden, view.scene.time_s))
    shown = tuple(newcomer for newcomer in newcomers if not newcomer.is_hidden)
    return shown, replace(memory, stage=stage)


def _update_standing(view: SituationView, memory: Commitments) -> Commitments:
    """Return the memory without standing vehicles that are no longer needed or could not be inserted."""
    before, now = memory.standing, view.scene.time_s
    if not before.members:
        return memory
    standing = before.updated(view)
    missing = set(before.names) - view.scene.history.index.keys()
    not_inserted = len(missing) if now - before.since_s <= PLAN_DT_S else 0
    stage = replace(memory.stage, most=memory.stage.most + not_inserted)  # others may be inserted instead
    if not_inserted and not standing.members:
        standing = replace(standing, next_try_s=now + _RETRY_S)
    agenda = memory.agenda if standing.members else memory.agenda.without(before.kind, now)
    return replace(memory, standing=standing, stage=stage, agenda=agenda)


def _commitment(manoeuvre: Manoeuvre, now_s: float, features: tuple[float, ...]) -> Commitment:
    goal_lane = "" if manoeuvre.goal is None else manoeuvre.goal.present_lane.id
    return Commitment(
        manoeuvre.kind,
        manoeuvre.profile,
        now_s,
        now_s,
        manoeuvre.is_positioning,
        manoeuvre.delay_s,
        goal_lane,
        features,
    )
