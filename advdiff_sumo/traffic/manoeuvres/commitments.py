"""What is remembered from plan to plan: the manoeuvres under way, and what the episode aims for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.traffic.manoeuvres.agenda import TURN_S, Agenda, approaches_yield_line, has_red_ahead
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference
from advdiff_sumo.traffic.manoeuvres.follower import FOLLOWS
from advdiff_sumo.traffic.manoeuvres.intensity import ANY_SEVERITY, ONCOMING, Intensity
from advdiff_sumo.traffic.manoeuvres.obstruction import WAITS
from advdiff_sumo.traffic.manoeuvres.priority_traffic import SHORT_GAPS
from advdiff_sumo.traffic.manoeuvres.repertoire import BESIDE_KINDS, DOUBLE, KINDS, SLOW_ENTRIES
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import SpeedProfile
from advdiff_sumo.traffic.manoeuvres.staging import StagingMemory
from advdiff_sumo.traffic.manoeuvres.standing_traffic import QUEUE, StandingTraffic

ANY_KINDS = tuple(KINDS)
"""Kinds in an episode of "any"; if ``SLOW_ENTRIES`` are added here, these get turns, too."""
UNPREDICTED_KINDS = (QUEUE, DOUBLE, *BESIDE_KINDS, SHORT_GAPS, *SLOW_ENTRIES)
"""Kinds for which no failures are predicted, so that a warm-up learns nothing of them."""
CROSSING_ATTACKS = (ONCOMING, SHORT_GAPS)
"""Attacks whose manoeuvres are crossings, and recorded as such."""
SUPPORT_KINDS = (FOLLOWS, WAITS)
"""Kinds that do not attack."""
LEADER_KINDS = frozenset(("hard-stop", "blocked-lane", "stop-and-go", DOUBLE))
"""Kinds of a leader, which keeps the target from reaching a crossing vehicle."""
_CLASSES_OF_FIVE = (*(AgentClass.TRUCK,) * 2, *(AgentClass.MOTORCYCLE,) * 2, AgentClass.CAR)
"""Classes of the first five inserted vehicles, and of every five after them."""
PATIENCE_S = 2.0 * TURN_S
"""Until then only the kind whose turn it is, and crossing, may begin."""


@dataclass(frozen=True)
class Commitment:
    """A manoeuvre under way.

    Attributes:
        kind: its kind.
        profile: its chosen speed over time.
        since_s: when it began.
        timed_s: when its profile began.
        is_positioning: whether it only gets into position.
        delay_s: how long after ``since_s`` it changes lanes.
        goal_lane: lane that it changes to; "" if it keeps its lane.
        features: features of the encounter as it began, see ``encounter_features``; () if there is no preference.
    """

    kind: str
    profile: SpeedProfile
    since_s: float
    timed_s: float
    is_positioning: bool
    delay_s: float = 0.0
    goal_lane: str = ""
    features: tuple[float, ...] = ()


@dataclass(frozen=True)
class Commitments:
    """What is remembered from plan to plan.

    Attributes:
        weights: kind → weight of its merit in this episode.
        active: id → its manoeuvre.
        rested_s: id → when it may take part again.
        stage: how many vehicles have been inserted, and which ones may be.
        agenda: which kinds the episode aims for, and when.
        intensity: prescribed severities.
        since_s: id → time since when it has been near the target.
        blocked_s: id → time since when the target's box has blocked its way.
        preference: for encounters in which the target is predicted to fail; None: nothing is predicted.
        standing: vehicles that stand ahead for an encounter.
        company: id → what each vehicle that accompanies the target takes part in, see ``company`` and ``close_pass``.
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
    company: Mapping[str, str] = field(default_factory=dict)

    def startable_kinds(self, view: SituationView) -> tuple[str, ...]:
        """Return the kinds that may begin now: at first the one whose turn it is and crossing, later all.

        Out of its turn crossing is left out before a red light. Leaders are left out before a junction where the target
        may have to yield.
        """
        turn = self.agenda.now
        if self.standing.is_queue:
            return ()
        if not turn:
            return tuple(kind for kind in self.weights if kind != QUEUE)
        kinds = self.insertable_kinds(view) if view.scene.time_s < PATIENCE_S else tuple(self.weights)
        needs_free_way = self.agenda.prioritises_crossing and approaches_yield_line(view)
        excluded = LEADER_KINDS if needs_free_way else frozenset[str]()
        if turn != "crossing" and has_red_ahead(view):
            excluded |= {"crossing"}
        return tuple(kind for kind in self.weights if kind in kinds and kind not in excluded)

    def insertable_kinds(self, view: SituationView) -> tuple[str, ...]:
        """Return the kinds for which vehicles may be inserted now.

        These are the kind whose turn it is and crossing, which needs no turn unless too few failures are predicted.
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
        """Ids of the attackers; vehicles that only get into position are left out."""
        attackers = (
            name
            for name, under_way in self.active.items()
            if not under_way.is_positioning and under_way.kind not in SUPPORT_KINDS
        )
        return (*attackers, *(self.standing.names if self.standing.is_queue else ()))

    @property
    def manoeuvres(self) -> Mapping[str, str]:
        """Id → the kind of manoeuvre that it drives or takes part in; followers are left out."""
        kinds = {
            name: under_way.kind
            for name, under_way in self.active.items()
            if not under_way.is_positioning and under_way.kind != FOLLOWS
        }
        return {
            **self.company,
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
        """Return no commitments, with random weights and turns, so that episodes differ.

        Args:
            attack: a kind, or "any".
            rng: for the draws.
            staged: most vehicles that may be inserted.
            intensity: prescribed severities.
            preference: for encounters; turns and inserted vehicles follow it too if *attack* is "any".
        """
        kind = "crossing" if attack in CROSSING_ATTACKS else attack
        slow = () if preference is not None else tuple(entry for entry in SLOW_ENTRIES if entry in ANY_KINDS)
        kinds = [name for name in ANY_KINDS if name in (*KINDS, *slow)] if kind == "any" else [kind]
        weights = dict(zip(kinds, (1.0 - 0.7 * rng.random(len(kinds))).tolist(), strict=True))
        classes = _newcomer_classes(rng, max(staged, 1))
        oncoming = bool(rng.random() < 0.5)
        stage = StagingMemory(staged, classes, oncoming, attack == ONCOMING, attack == SHORT_GAPS, intensity)
        agenda = Agenda.draw(rng, slow) if attack == "any" else Agenda()
        if preference is not None and attack in UNPREDICTED_KINDS:
            preference = None
        elif preference is not None and attack != "any":
            preference = replace(preference, kinds=(kind,))
        elif preference is not None:
            shares = {
                agent_class: _CLASSES_OF_FIVE.count(agent_class) / len(_CLASSES_OF_FIVE)
                for agent_class in _CLASSES_OF_FIVE
            }
            wanted, preference = preference.draw(rng, shares, len(classes))
            if wanted is not None:
                stage = replace(stage, classes=wanted.classes, oncoming=wanted.oncoming)
                agenda = wanted.agenda
        return Commitments(weights, stage=stage, agenda=agenda, intensity=intensity, preference=preference)


def _newcomer_classes(rng: np.random.Generator, number: int) -> tuple[AgentClass, ...]:
    """Return the classes of *number* inserted vehicles: ``_CLASSES_OF_FIVE``, in a new random order every time."""
    fives = rng.random((-(-number // len(_CLASSES_OF_FIVE)), len(_CLASSES_OF_FIVE))).argsort(axis=1)
    return tuple(_CLASSES_OF_FIVE[i] for i in fives.ravel()[:number].tolist())
