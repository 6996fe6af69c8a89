"""Manoeuvres over time: chosen, carried on while they are lawful and of use, and over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.metrics.breaches.lane_rules import SAME_WAY_RAD
from advdiff_sumo.traffic.manoeuvres.agenda import TURN_S, Agenda, comes_to_yield, is_possible, waits_at_red
from advdiff_sumo.traffic.manoeuvres.choice import Chosen, rank
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference
from advdiff_sumo.traffic.manoeuvres.follower import (
    FOLLOWS,
    braking_behind,
    follower_of_target,
    follows_still,
)
from advdiff_sumo.traffic.manoeuvres.graded import braking_with, graded, target_brakes
from advdiff_sumo.traffic.manoeuvres.intensity import AS_SERVES, Intensity
from advdiff_sumo.traffic.manoeuvres.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.ordinary_driving import in_view_since, is_due, perceived_s
from advdiff_sumo.traffic.manoeuvres.plan_licence import CARELESS_ALLOWS, plan_breaches
from advdiff_sumo.traffic.manoeuvres.profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS, crossing_on
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, Stage, come_in
from advdiff_sumo.traffic.manoeuvres.ways import Way

STANDS = "stands"
"""What somebody does who has come in to stand: a vehicle that has broken down."""
_SUPPORTS = (STANDS, FOLLOWS)
_LONGEST_S: Mapping[str, float] = {STANDS: 60.0, "blocked-lane": 14.0, "hard-stop": 9.0, "stop-and-go": 6.0}
_LONGEST_DEFAULT_S = 7.0
_STOPS = ("hard-stop", "blocked-lane", "cut-in")
_KEEP_OFF = frozenset(("hard-stop", "blocked-lane", "stop-and-go"))
_LORRIES, _MOTORCYCLES = 0.4, 0.3
_SHARES = {
    AgentClass.CAR: 1.0 - _LORRIES - _MOTORCYCLES,
    AgentClass.TRUCK: _LORRIES,
    AgentClass.MOTORCYCLE: _MOTORCYCLES,
}
"""Shares of those who come in."""
_PATIENCE = ((2.0 * TURN_S, 0.4),)
"""Until when (s) an episode waits for a better moment than one of so little merit."""
_LEADER_PATIENCE = ((TURN_S, 0.7), (4.0 * TURN_S, 0.4))
"""The same for a leader that lets the target close up, and which no red light stops soon."""
_PATIENT_S = _PATIENCE[-1][0]
_STANDS_MPS, _OVER_LINE_M, _IN_WAY_M = 0.5, 0.2, 1.2
_NOW_S = 0.5
_TRIED = 4
"""Manoeuvres that are checked in full, best first."""


@dataclass(frozen=True)
class Commitment:
    """A manoeuvre under way.

    Attributes:
        kind: which.
        profile: its speed, as chosen.
        since_s: when it began.
        timed_s: when its profile did.
        sets_up: whether it only gets into position.
        delay_s: when, after that, it changes lanes.
        goal_lane: lane that it changes to; "" where it stays.
        features: of the encounter as it began, see ``encounter_features``; () where nobody prefers any.
    """

    kind: str
    profile: SpeedProfile
    since_s: float
    timed_s: float
    sets_up: bool
    delay_s: float = 0.0
    goal_lane: str = ""
    features: tuple[float, ...] = ()


@dataclass(frozen=True)
class Commitments:
    """What is remembered from plan to plan.

    Attributes:
        weights: kind → how much it is wanted in this episode.
        active: id → its manoeuvre.
        rested_s: id → when it may take part again.
        stage: who has come in for an encounter, and may.
        agenda: which kind the episode is for now.
        intensity: severities that are asked for.
        since_s: id → since when it has been near the target.
        preference: of encounters in which the target is predicted to fail; None: nothing is known.
    """

    weights: Mapping[str, float]
    active: Mapping[str, Commitment] = field(default_factory=dict)
    rested_s: Mapping[str, float] = field(default_factory=dict)
    stage: Stage = field(default_factory=Stage)
    agenda: Agenda = field(default_factory=Agenda)
    intensity: Intensity = AS_SERVES
    since_s: Mapping[str, float] = field(default_factory=dict)
    preference: EncounterPreference | None = None

    def wanted(self, view: SituationView) -> tuple[str, ...]:
        """Return the kinds that may begin now: at first the one whose turn it is and crossing, later all.

        Nobody crosses before a red light out of turn, nor leads a target to where it has to yield.
        """
        turn = self.agenda.now
        if not turn:
            return tuple(self.weights)
        kinds = self.staged(view) if view.scene.time_s < _PATIENT_S else tuple(self.weights)
        off = _KEEP_OFF if self.agenda.crosses_first and comes_to_yield(view) else frozenset[str]()
        red = {"crossing"} if turn != "crossing" and waits_at_red(view) else set[str]()
        return tuple(kind for kind in self.weights if kind in kinds and kind not in off | red)

    def staged(self, view: SituationView) -> tuple[str, ...]:
        """Return the kinds for which vehicles come in now.

        That is the kind whose turn it is and crossing, which waits for no turn unless it promises too little.
        """
        turn = self.agenda.now
        if not turn:
            return tuple(self.weights)
        crosses = self.agenda.crosses_any_time and not waits_at_red(view)
        return tuple({turn: 0} | ({"crossing": 0} if crosses else {}))

    @property
    def attacking(self) -> tuple[str, ...]:
        """Ids of those in a manoeuvre that are past getting into position for it."""
        return tuple(
            name
            for name, under_way in self.active.items()
            if not under_way.sets_up and under_way.kind not in _SUPPORTS
        )

    @property
    def manoeuvres(self) -> Mapping[str, str]:
        """Id → the kind of manoeuvre that it drives; who stands is part of a cut-out, who follows does nothing."""
        kinds = {
            name: under_way.kind
            for name, under_way in self.active.items()
            if not under_way.sets_up and under_way.kind != FOLLOWS
        }
        return {name: "cut-out" if kind == STANDS else kind for name, kind in kinds.items()}

    @staticmethod
    def start(
        attack: str,
        rng: np.random.Generator,
        staged: int = 0,
        intensity: Intensity = AS_SERVES,
        preference: EncounterPreference | None = None,
    ) -> Commitments:
        """Return none, with preferences drawn for *attack*, a kind or "any", so that episodes differ.

        Args:
            attack: the kind.
            rng: for the draws.
            staged: most vehicles that may come in.
            intensity: severities that are asked for.
            preference: of encounters, which turns and newcomers follow too where *attack* is "any".
        """
        kinds = list(KINDS) if attack == "any" else [attack]
        weights = dict(zip(kinds, (1.0 - 0.7 * rng.random(len(kinds))).tolist(), strict=True))
        classes = tuple(_class_of(draw) for draw in rng.random(max(staged, 1)).tolist())
        oncoming = bool(rng.random() < 0.5)
        stage = Stage(staged, classes, oncoming, intensity.early_s, intensity.spare_gap_m or 0.0)
        agenda = Agenda.drawn(rng) if attack == "any" else Agenda()
        if preference is not None and attack == "any":
            wanted, preference = preference.drawn(rng, _SHARES, len(classes))
            if wanted is not None:
                stage = replace(stage, classes=wanted.classes, oncoming=wanted.oncoming)
                agenda = wanted.agenda
        return Commitments(weights, stage=stage, agenda=agenda, intensity=intensity, preference=preference)


def advance(
    view: SituationView, kept: Commitments, attackers: int, pause_s: float, licence: Licence | None = LAWFUL
) -> tuple[list[Manoeuvre], Commitments]:
    """Return the manoeuvres that are driven now, and what is remembered of them.

    Args:
        view: the scene.
        kept: from the plan before.
        attackers: most vehicles that are in a manoeuvre at a time.
        pause_s: rest of a vehicle after a manoeuvre.
        licence: what they may do; None: anything.
    """
    kept = replace(kept, agenda=kept.agenda.at(view), since_s=in_view_since(view, kept.since_s))
    going, kept = _carry_on(view, kept, pause_s, licence)
    room = attackers - sum(m.kind not in _SUPPORTS for m in going)
    chosen = _begin(view, kept, going, room, licence) if room > 0 else []
    features = {one.manoeuvre.row: one.features for one in chosen}
    fresh = [one.manoeuvre for one in chosen]
    fresh += _behind(view, [*going, *fresh], fresh, licence)
    names, now = view.scene.history.ids, view.scene.time_s
    begun = {names[m.row]: _commitment(m, now, features.get(m.row, ())) for m in fresh}
    return [*going, *fresh], replace(kept, active={**kept.active, **begun})


def let_in(view: SituationView, kept: Commitments) -> tuple[tuple[Newcomer, ...], Commitments]:
    """Return who comes in now, for the manoeuvres that may begin, and what is remembered of them."""
    busy = {under_way.kind for under_way in kept.active.values() if not under_way.sets_up}
    kinds = [kind for kind in kept.staged(view) if kind not in busy]
    possible = "crossing" in kinds and is_possible(view, "crossing")
    if kept.agenda.crosses_first and ("crossing" in busy or possible or comes_to_yield(view)):
        kinds = [
            kind for kind in kinds if kind == "crossing"
        ]  # a leader would keep the target from the junction
    newcomers, stage = come_in(view, kept.stage, kinds)
    now = view.scene.time_s
    still = Commitment(STANDS, SpeedProfile(then_mps2=-1.0), now, now, sets_up=False)
    standing = {one.name: still for one in newcomers if one.speed_mps == 0.0}
    return newcomers, replace(kept, stage=stage, active={**kept.active, **standing})


def _class_of(draw: float) -> AgentClass:
    """Return what comes in for a *draw* from 0 to 1."""
    if draw < _LORRIES:
        return AgentClass.TRUCK
    return AgentClass.MOTORCYCLE if draw >= 1.0 - _MOTORCYCLES else AgentClass.CAR


def _commitment(manoeuvre: Manoeuvre, now_s: float, features: tuple[float, ...]) -> Commitment:
    lane = "" if manoeuvre.goal is None else manoeuvre.goal.present_lane.id
    return Commitment(
        manoeuvre.kind,
        manoeuvre.profile,
        now_s,
        now_s,
        manoeuvre.sets_up,
        manoeuvre.delay_s,
        lane,
        features,
    )


def _begin(
    view: SituationView, kept: Commitments, going: Sequence[Manoeuvre], room: int, licence: Licence | None
) -> list[Chosen]:
    """Return the best new manoeuvres beside those *going* on, one a vehicle, one that crosses, at most *room*."""
    names, now = view.scene.history.ids, view.scene.time_s
    busy = {m.row for m in going}
    free = [r for r in view.movable if r not in busy and kept.rested_s.get(names[r], -1.0) <= now]
    wanted = kept.wanted(view)
    possible = [m for row in free for kind in wanted for m in KINDS[kind](view, row)]
    due = [m for m in possible if is_due(view, m, kept.since_s)]
    proposals = list(graded(view, due, kept.intensity))
    out: list[Chosen] = []
    ranked = rank(view, proposals, kept.weights, licence, kept.intensity, preference=kept.preference)
    patience = _LEADER_PATIENCE if kept.agenda.order and not waits_at_red(view) else _PATIENCE
    least = {kind: _least(patience if kind in _KEEP_OFF else _PATIENCE, now) for kind in kept.weights}
    worthy = [one for one in ranked if one.manoeuvre.sets_up or one.merit >= least[one.manoeuvre.kind]]
    for chosen in worthy[:_TRIED]:
        others = (*going, *(one.manoeuvre for one in out))
        fits = all(_go_together(chosen.manoeuvre, other) for other in others)
        if len(out) < room and fits and _spares_follower(view, chosen) and _passes(view, chosen, licence):
            driven = braking_with(chosen.manoeuvre, kept.intensity.braking_mps2)
            out.append(replace(chosen, manoeuvre=driven))
    return out


def _least(patience: Sequence[tuple[float, float]], now_s: float) -> float:
    """Return the merit below which an episode waits for a better moment."""
    return next((merit for until_s, merit in patience if now_s < until_s), 0.0)


def _go_together(one: Manoeuvre, other: Manoeuvre) -> bool:
    """Return whether both can be driven: two that cross would meet each other, and a leader would stop the target."""
    if one.row == other.row or one.kind == other.kind == "crossing":
        return False
    return "crossing" not in (one.kind, other.kind) or not {one.kind, other.kind} & _KEEP_OFF


def _spares_follower(view: SituationView, chosen: Chosen) -> bool:
    """Return whether who follows the target can brake for it, too."""
    behind = follower_of_target(view)
    if behind is None or behind == chosen.manoeuvre.row or chosen.manoeuvre.sets_up:
        return True
    return braking_behind(view, behind, perceived_s(view, chosen.manoeuvre)) is not None


def _behind(
    view: SituationView, driven: Sequence[Manoeuvre], fresh: Sequence[Manoeuvre], licence: Licence | None
) -> list[Manoeuvre]:
    """Return what who follows the target drives where it has to answer now, if it may be moved and does not yet.

    It answers one of *fresh*, or of those *driven* somebody who crosses once it is near.
    """
    row = follower_of_target(view)
    if row not in view.movable or any(m.row == row or m.kind == FOLLOWS for m in driven):
        return []
    attacks = [m for m in driven if not m.sets_up and (m in fresh or m.kind == "crossing")]
    times_s = [(m.kind, perceived_s(view, m)) for m in attacks if m.kind not in _SUPPORTS]
    soon_s = [time_s for kind, time_s in times_s if kind != "crossing" or time_s < _NOW_S]
    brakes = braking_behind(view, row, min(soon_s)) if soon_s else None
    return [brakes] if brakes is not None and _still_lawful(view, brakes, licence) else []


def _passes(view: SituationView, chosen: Chosen, licence: Licence | None) -> bool:
    """Return whether the breach rules of the verdict find nothing in the plan of *chosen*."""
    if licence is None or chosen.manoeuvre.sets_up:
        return True
    future = chosen.futures
    rows = [chosen.manoeuvre.row]
    broken = plan_breaches(view, rows, future.xy_m, future.yaw_rad, future.speed_mps)[0]
    return not (broken - (CARELESS_ALLOWS if licence is not LAWFUL else frozenset()))


def _carry_on(
    view: SituationView, kept: Commitments, pause_s: float, licence: Licence | None
) -> tuple[list[Manoeuvre], Commitments]:
    """Return the manoeuvres under way that go on within the licence, and the memory without the others."""
    index, now = view.scene.history.index, view.scene.time_s
    going: list[Manoeuvre] = []
    active, rested = dict(kept.active), dict(kept.rested_s)
    for name, under_way in kept.active.items():
        row = index.get(name)
        manoeuvre = _continued(view, row, under_way, kept.intensity, licence) if row in view.movable else None
        if manoeuvre is not None and (manoeuvre.kind == STANDS or _still_lawful(view, manoeuvre, licence)):
            going.append(manoeuvre)
            active[name] = replace(under_way, profile=manoeuvre.profile, timed_s=now)
            continue
        del active[name]
        rested[name] = now + (0.0 if under_way.sets_up or under_way.kind == FOLLOWS else pause_s)
    if all(m.kind in _SUPPORTS for m in going):  # nobody attacks: who follows is its own driver again
        going = [m for m in going if m.kind != FOLLOWS]
        active = {name: under_way for name, under_way in active.items() if under_way.kind != FOLLOWS}
    return going, replace(kept, active=active, rested_s=rested)


def _continued(
    view: SituationView,
    row: int | None,
    under_way: Commitment,
    intensity: Intensity,
    licence: Licence | None,
) -> Manoeuvre | None:
    """Return the rest of a manoeuvre; None where it is over."""
    passed = view.scene.time_s - under_way.since_s
    longest = _LONGEST_S.get(under_way.kind, _LONGEST_DEFAULT_S)
    if row is None or under_way.sets_up or passed >= longest:
        return None
    if under_way.kind in _STOPS and _target_stands(view) and view.speed(row) < _STANDS_MPS:
        return None  # both stand: the question is answered
    if under_way.kind in _KEEP_OFF and not _is_ahead(view, row):
        return None  # the target has left its lane, or is past it
    if under_way.kind == "crossing":
        if _is_before(view, row):
            return None  # who has come out ahead of it is a leader
        timed = list(crossing_on(view, row))
        again = rank(view, timed, {"crossing": 1.0}, licence, intensity, begun=True)
        holds = intensity.is_asked_of("crossing") and target_brakes(view)
        if again and not holds and not (again[0].needed_mps2 == 0.0 and _target_stands(view)):
            return again[0].manoeuvre
        if _target_stands(view):
            return None
    begun = under_way.profile
    rest = replace(begun, switch_s=max(begun.switch_s - (view.scene.time_s - under_way.timed_s), 0.0))
    if under_way.kind == "crossing":  # a lane of a junction may have another limit
        limit = max(view.ways[row].lane.speed_mps, view.speed(row))
        rest = replace(rest, highest_mps=min(rest.highest_mps, limit))
    goal = _goal(view, row, under_way)
    delay_s = max(under_way.delay_s - passed, 0.0)
    manoeuvre = Manoeuvre(under_way.kind, row, view.ways[row], rest, goal, delay_s=delay_s)
    return manoeuvre if under_way.kind != FOLLOWS or follows_still(view, manoeuvre) else None


def _is_before(view: SituationView, row: int) -> bool:
    """Return whether the target drives ahead of *row* on its way, in the same direction."""
    target = view.target
    if target is None:
        return False
    ahead, left = view.place_on(view.ways[row], view.scene.target)
    yaw = view.scene.history.yaw_rad[:, -1]
    same_way = abs(float(wrap_angle(float(yaw[row] - yaw[view.scene.target])))) < SAME_WAY_RAD
    return same_way and ahead > 0.0 and abs(left) < _IN_WAY_M


def _is_ahead(view: SituationView, row: int) -> bool:
    """Return whether *row* is ahead of the target on its way, or not wholly beside it."""
    target = view.target
    if target is None:
        return True
    ahead, left = view.place_on(target.way, row)
    return ahead > 0.0 and abs(left) < 0.5 * float(view.size(row)[1] + target.size_m[1])


def _target_stands(view: SituationView) -> bool:
    return view.target is None or view.target.speed_mps < _STANDS_MPS


def _goal(view: SituationView, row: int, under_way: Commitment) -> Way | None:
    """Return the way that *row* is still changing to; None once it is on it."""
    if under_way.kind == "cut-out":
        sides = (view.neighbour(row, side) for side in ("left", "right"))
        return next((way for way in sides if way and way.present_lane.id == under_way.goal_lane), None)
    if under_way.kind != "cut-in":
        return None
    again = [m.goal for m in KINDS["cut-in"](view, row) if m.goal is not None]
    return again[0] if again else None


def _still_lawful(view: SituationView, manoeuvre: Manoeuvre, licence: Licence | None) -> bool:
    """Return whether *manoeuvre* goes on: with the gap that the rule asks for, and none once it is over the line."""
    futures = futures_of_manoeuvres([manoeuvre], np.array([view.speed(manoeuvre.row)]))
    if licence is not None:
        licence = replace(licence, gap_share=min(licence.gap_share, 1.0), spare_m=0.0)
    goal = manoeuvre.goal
    if goal is not None:
        across = abs(float(goal.line.project(view.scene.history.xy_m[manoeuvre.row, -1])[1]))
        own_width = float(view.size(manoeuvre.row)[1])
        if across < 0.5 * (goal.present_lane.width_m + own_width) - _OVER_LINE_M:
            manoeuvre = replace(manoeuvre, goal=None)
    return bool(lawful(view, [manoeuvre], futures, licence, begun=True)[0])
