"""What is remembered of manoeuvres from plan to plan: which are under way, and what an episode asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.traffic.manoeuvres.agenda import TURN_S, Agenda, approaches_yield_line, has_red_ahead
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference
from advdiff_sumo.traffic.manoeuvres.follower import FOLLOWS
from advdiff_sumo.traffic.manoeuvres.intensity import ANY_SEVERITY, Intensity
from advdiff_sumo.traffic.manoeuvres.obstruction import WAITS
from advdiff_sumo.traffic.manoeuvres.oncoming import ONCOMING
from advdiff_sumo.traffic.manoeuvres.repertoire import DOUBLE, KINDS, SLOW_ENTRIES
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory
from advdiff_sumo.traffic.manoeuvres.standing_traffic import QUEUE, StandingTraffic

ANY_KINDS = tuple(KINDS)
"""Kinds that an episode of "any" is made of; with ``SLOW_ENTRIES`` here those get turns, too."""
SUPPORT_KINDS = (FOLLOWS, WAITS)
"""Kinds that attack nobody."""
LEADER_KINDS = frozenset(("hard-stop", "blocked-lane", "stop-and-go", DOUBLE))
"""Kinds of a leader, who keeps the target from where others would cross it."""
_FIVE = (*(AgentClass.TRUCK,) * 2, *(AgentClass.MOTORCYCLE,) * 2, AgentClass.CAR)
"""Classes of the first five who come in, and of every five after them."""
PATIENCE_S = 2.0 * TURN_S
"""Until when an episode waits for the kind whose turn it is."""


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
        blocked_s: id → since when the target's box has been on its way, where SUMO does not see it.
        preference: of encounters in which the target is predicted to fail; None: nothing is known.
        standing: who stands ahead for an encounter.
        company: ids of those who accompany the target now, see ``company``.
    """

    weights: Mapping[str, float]
    active: Mapping[str, Commitment] = field(default_factory=dict)
    rested_s: Mapping[str, float] = field(default_factory=dict)
    stage: StagingMemory = field(default_factory=StagingMemory)
    agenda: Agenda = field(default_factory=Agenda)
    intensity: Intensity = ANY_SEVERITY
    since_s: Mapping[str, float] = field(default_factory=dict)
    blocked_s: Mapping[str, float] = field(default_factory=dict)
    preference: EncounterPreference | None = None
    standing: StandingTraffic = field(default_factory=StandingTraffic)
    company: tuple[str, ...] = ()

    def startable_kinds(self, view: SituationView) -> tuple[str, ...]:
        """Return the kinds that may begin now: at first the one whose turn it is and crossing, later all.

        Nobody crosses before a red light out of turn, nor leads a target to where it has to yield.
        """
        turn = self.agenda.now
        if self.standing.is_queue:
            return ()
        if not turn:
            return tuple(kind for kind in self.weights if kind != QUEUE)
        kinds = self.insertable_kinds(view) if view.scene.time_s < PATIENCE_S else tuple(self.weights)
        off = (
            LEADER_KINDS
            if self.agenda.prioritises_crossing and approaches_yield_line(view)
            else frozenset[str]()
        )
        red = {"crossing"} if turn != "crossing" and has_red_ahead(view) else set[str]()
        return tuple(kind for kind in self.weights if kind in kinds and kind not in off | red)

    def insertable_kinds(self, view: SituationView) -> tuple[str, ...]:
        """Return the kinds for which vehicles come in now.

        That is the kind whose turn it is and crossing, which waits for no turn unless it promises too little.
        """
        turn = self.agenda.now
        if self.standing.is_queue:
            return ()
        if not turn:
            return tuple(self.weights)
        crosses = self.agenda.crosses_any_time and not has_red_ahead(view)
        return tuple({turn: 0} | ({"crossing": 0} if crosses else {}))

    @property
    def attacking(self) -> tuple[str, ...]:
        """Ids of those in a manoeuvre that are past getting into position for it."""
        driving = (
            name
            for name, under_way in self.active.items()
            if not under_way.sets_up and under_way.kind not in SUPPORT_KINDS
        )
        return (*driving, *(self.standing.names if self.standing.is_queue else ()))

    @property
    def manoeuvres(self) -> Mapping[str, str]:
        """Id → the kind of manoeuvre that it drives, or takes part in; who follows does nothing."""
        kinds = {
            name: under_way.kind
            for name, under_way in self.active.items()
            if not under_way.sets_up and under_way.kind != FOLLOWS
        }
        return {
            **dict.fromkeys(self.company, DOUBLE),
            **kinds,
            **dict.fromkeys(self.standing.names, self.standing.kind),
        }

    @staticmethod
    def start(
        attack: str,
        rng: np.random.Generator,
        staged: int = 0,
        intensity: Intensity = ANY_SEVERITY,
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
        asked = "crossing" if attack == ONCOMING else attack
        slow = () if preference is not None else tuple(kind for kind in SLOW_ENTRIES if kind in ANY_KINDS)
        kinds = [kind for kind in ANY_KINDS if kind in (*KINDS, *slow)] if asked == "any" else [asked]
        weights = dict(zip(kinds, (1.0 - 0.7 * rng.random(len(kinds))).tolist(), strict=True))
        classes = _newcomers(rng, max(staged, 1))
        oncoming = bool(rng.random() < 0.5)
        stage = StagingMemory(
            staged, classes, oncoming, intensity.early_s, intensity.spare_gap_m or 0.0, attack == ONCOMING
        )
        agenda = Agenda.draw(rng, slow) if attack == "any" else Agenda()
        if preference is not None and attack in (QUEUE, DOUBLE, *SLOW_ENTRIES):
            preference = None  # nothing is predicted of it
        elif preference is not None and attack != "any":
            preference = replace(preference, kinds=(asked,))
        elif preference is not None:
            wanted, preference = preference.draw(
                rng, {one: _FIVE.count(one) / len(_FIVE) for one in _FIVE}, len(classes)
            )
            if wanted is not None:
                stage = replace(stage, classes=wanted.classes, oncoming=wanted.oncoming)
                agenda = wanted.agenda
        return Commitments(weights, stage=stage, agenda=agenda, intensity=intensity, preference=preference)


def _newcomers(rng: np.random.Generator, number: int) -> tuple[AgentClass, ...]:
    """Return the classes of *number* who come in, every five of them as ``_FIVE``, in an order that is drawn."""
    fives = rng.random((-(-number // len(_FIVE)), len(_FIVE))).argsort(axis=1)
    return tuple(_FIVE[i] for i in fives.ravel()[:number].tolist())
