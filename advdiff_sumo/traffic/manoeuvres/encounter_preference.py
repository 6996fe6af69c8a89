"""Which encounters an episode goes for, where it is known in which ones the target fails.

Turns, classes of vehicle and sides are drawn the more often the more failures are predicted, and manoeuvres are
ranked by them; a share of the episodes draws as if nothing were known, so that findings stay diverse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.models.failure_predictor import FailurePredictor, load_failures
from advdiff_sumo.traffic.manoeuvres.agenda import TURNING_KINDS, Agenda
from advdiff_sumo.traffic.manoeuvres.encounter_features import FEATURES, encounter_features, with_vehicle
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

EXPLORATION_SHARE = 0.15
"""Share of the episodes that draw as if nothing were known."""
_TURNS = 4
_GREED = 3.0
"""Power of the failures that are predicted, in whose proportion is drawn."""
_PROBES = ("hard-stop", "hard-stop", "hard-stop", "cut-in", "crossing", "cut-in", "crossing")
"""Kinds of a warm-up's questions; three stops by different vehicles tell kind and vehicle apart."""
_CLASSES = (AgentClass.CAR, AgentClass.TRUCK, AgentClass.MOTORCYCLE)
_WORTHLESS = 0.2
"""What promises less than this share of the best encounter does not begin: it would take the other's place."""
_AT_ANY_TIME = 0.5
"""Somebody with priority may come in the turn of another kind where it promises this share of the best kind's."""


@dataclass(frozen=True)
class EncounterPreference:
    """What is predicted of the target.

    Attributes:
        predictor: of its failures.
        explores: share of the episodes that draw as if nothing were known.
        probe: number of the question of a warm-up, for which kinds and classes take turns; None: there is none.
        kinds: of the encounters that may come.
    """

    predictor: FailurePredictor
    explores: float = EXPLORATION_SHARE
    probe: int | None = None
    kinds: tuple[str, ...] = tuple(KINDS)

    @staticmethod
    def read(path: Path) -> EncounterPreference:
        """Read what a lawful warm-up wrote.

        Raises:
            WeightsError: the file is missing, damaged, or no such one.
        """
        return EncounterPreference(load_failures(path, len(FEATURES)))

    def rate(
        self, view: SituationView, proposals: Sequence[Manoeuvre], needed_mps2: FloatArray
    ) -> tuple[list[tuple[float, ...]], FloatArray]:
        """Return features of *proposals* and (C,) what each is worth by the failures that are predicted of it.

        1 for the best one and for getting into position; 0 for who keeps a far better encounter from coming.
        """
        features = encounter_features(view, proposals, needed_mps2)
        return [tuple(row) for row in features.tolist()], self._worth(
            features, np.array([one.sets_up for one in proposals])
        )

    def _worth(self, features: FloatArray, sets_up: BoolArray) -> FloatArray:
        if self.explores == 1.0 or sets_up.all():
            return np.ones(len(features))
        predicted = self.predictor.probability(features)
        predicted[~sets_up & (predicted < _WORTHLESS * self._most)] = 0.0
        return np.where(sets_up, 1.0, predicted / max(predicted[~sets_up].max(), np.finfo(np.float64).tiny))

    @cached_property
    def _most(self) -> float:
        """The failures predicted of the best encounter of ``kinds``."""
        return max(
            self.predicted_failures(kind, one, side)
            for kind in self.kinds
            for one in _CLASSES
            for side in (False, True)
        )

    def predicted_failures(self, kind: str, agent_class: AgentClass, oncoming: bool) -> float:
        """Return the failures predicted of the mean encounter of *kind* with such a vehicle."""
        typical = self.predictor.typical[tuple(KINDS).index(kind)]
        features = with_vehicle(typical, agent_class, oncoming if kind == "crossing" else None)
        return float(self.predictor.probability(features[None])[0])

    def draw(
        self, rng: np.random.Generator, shares: Mapping[AgentClass, float], count: int
    ) -> tuple[Wanted | None, EncounterPreference]:
        """Return what an episode goes for, and what it prefers; where it explores, None and nothing.

        Args:
            rng: for the draws.
            shares: class → how often it comes in where nothing is known.
            count: classes to draw.
        """
        if self.probe is not None:
            kind = probed_kind(self.probe)
            agenda = Agenda(tuple(dict.fromkeys((kind, "hard-stop"))), crosses_any_time=False)
            wanted = Wanted(agenda, (probed_class(self.probe),) * count, oncoming=bool(self.probe % 2))
            return wanted, replace(self, explores=1.0)
        if rng.random() < self.explores:
            return None, replace(self, explores=1.0)
        return self._wanted(rng, shares, count), self

    def _wanted(self, rng: np.random.Generator, shares: Mapping[AgentClass, float], count: int) -> Wanted:
        table = self._table(shares)
        of_kinds, of_classes = table.sum(axis=(1, 2)), table.sum(axis=(0, 2))
        least = _AT_ANY_TIME**_GREED * of_kinds.max()
        across = table[TURNING_KINDS.index("crossing")].sum(axis=0)
        hides = int(rng.random() < of_kinds[0] / of_kinds.sum())  # the first instant alone allows a cut-out
        turns = rng.choice(TURNING_KINDS[1:], size=_TURNS, p=of_kinds[1:] / of_kinds[1:].sum()).tolist()
        rest = [kind for kind in TURNING_KINDS[1:] if kind not in turns]
        classes = rng.choice(len(shares), size=count, p=of_classes / of_classes.sum()).tolist()
        return Wanted(
            Agenda(
                (*TURNING_KINDS[:hides], *turns, *rest),
                crosses_any_time=bool(of_kinds[TURNING_KINDS.index("crossing")] >= least),
            ),
            tuple([*shares][k] for k in classes),
            oncoming=bool(rng.random() < across[1] / across.sum()),
        )

    def _table(self, shares: Mapping[AgentClass, float]) -> FloatArray:
        """Return (K, C, 2) how often each of ``TURNING_KINDS`` is drawn with each class, from side and ahead."""
        promised = [
            [[self.predicted_failures(kind, one, oncoming) for oncoming in (False, True)] for one in shares]
            for kind in TURNING_KINDS
        ]
        return np.asarray(np.array(promised) ** _GREED * np.array([*shares.values()])[:, None] / 2.0)


@dataclass(frozen=True)
class Wanted:
    """What an episode goes for.

    Attributes:
        agenda: kinds in the order of their turns.
        classes: what comes in first, second, ….
        oncoming: whether somebody with priority comes from ahead rather than from the side.
    """

    agenda: Agenda
    classes: tuple[AgentClass, ...]
    oncoming: bool


def probed_kind(probe: int) -> str:
    """Return the kind of manoeuvre that question number *probe* of a warm-up asks about."""
    return _PROBES[probe % len(_PROBES)]


def probed_class(probe: int) -> AgentClass:
    """Return what comes in for question number *probe* of a warm-up."""
    return _CLASSES[probe % len(_CLASSES)]


def answers(probe: int, features: FloatArray) -> bool:
    """Return whether one of the encounters with *features* (N, D) was of the kind and class of vehicle asked for."""
    kind = features[:, FEATURES.index(probed_kind(probe))] == 1.0
    return bool((kind & (features == with_vehicle(features, probed_class(probe))).all(axis=-1)).any())
