"""Which encounters an episode aims for, if it is known in which ones the target fails.

Turns, classes of vehicles and their sides are drawn more often the more failures are predicted for them, and manoeuvres
are ranked by these predictions. A share of the episodes draws without them, so that findings stay diverse.
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
"""Share of the episodes that draw without predictions."""
_TURNS = 4
_PREFERENCE_POWER = 3.0
"""Encounters are drawn in proportion to this power of their predicted failures."""
_PROBES = ("hard-stop", "hard-stop", "hard-stop", "cut-in", "crossing", "cut-in", "crossing")
"""Kinds that a warm-up probes; three stops by different vehicles tell the effects of kind and vehicle apart."""
_CLASSES = (AgentClass.CAR, AgentClass.TRUCK, AgentClass.MOTORCYCLE)
_MIN_SHARE_OF_BEST = 0.2
"""An encounter with fewer predicted failures than this share of the best one's does not begin: it would replace it."""
_CROSSING_SHARE = 0.5
"""A vehicle with priority may come in the turn of another kind if it has this share of the best kind's prediction."""


@dataclass(frozen=True)
class EncounterPreference:
    """Predictions about the target.

    Attributes:
        predictor: predictor of its failures.
        exploration_share: share of the episodes that draw without predictions.
        probe: number of the warm-up's probe, for which kinds and classes take turns; None: this is no warm-up.
        kinds: kinds of the encounters that may come.
    """

    predictor: FailurePredictor
    exploration_share: float = EXPLORATION_SHARE
    probe: int | None = None
    kinds: tuple[str, ...] = tuple(KINDS)

    @staticmethod
    def read(path: Path) -> EncounterPreference:
        """Read the file of a lawful warm-up.

        Raises:
            WeightsError: the file is missing, damaged, or no such one.
        """
        return EncounterPreference(load_failures(path, len(FEATURES)))

    def rate(
        self, view: SituationView, proposals: Sequence[Manoeuvre], needed_mps2: FloatArray
    ) -> tuple[list[tuple[float, ...]], FloatArray]:
        """Return features of *proposals*, and (C,) factors on their merit that follow from the predicted failures.

        The factor is 1 for the best one and for getting into position. It is 0 for one that would keep a far better
        encounter from coming.
        """
        features = encounter_features(view, proposals, needed_mps2)
        return [tuple(row) for row in features.tolist()], self._factors(
            features, np.array([manoeuvre.is_positioning for manoeuvre in proposals])
        )

    def _factors(self, features: FloatArray, is_positioning: BoolArray) -> FloatArray:
        if self.exploration_share == 1.0 or is_positioning.all():
            return np.ones(len(features))
        predicted = self.predictor.probability(features)
        predicted[~is_positioning & (predicted < _MIN_SHARE_OF_BEST * self._best_prediction)] = 0.0
        best = max(predicted[~is_positioning].max(), np.finfo(np.float64).tiny)
        return np.where(is_positioning, 1.0, predicted / best)

    @cached_property
    def _best_prediction(self) -> float:
        """The predicted failures of the best encounter of ``kinds``."""
        return max(
            self.predicted_failures(kind, agent_class, oncoming)
            for kind in self.kinds
            for agent_class in _CLASSES
            for oncoming in (False, True)
        )

    def predicted_failures(self, kind: str, agent_class: AgentClass, oncoming: bool) -> float:
        """Return the predicted failures of the mean encounter of *kind* with such a vehicle."""
        typical = self.predictor.typical[tuple(KINDS).index(kind)]
        features = with_vehicle(typical, agent_class, oncoming if kind == "crossing" else None)
        return float(self.predictor.probability(features[None])[0])

    def draw(
        self, rng: np.random.Generator, shares: Mapping[AgentClass, float], count: int
    ) -> tuple[Wanted | None, EncounterPreference]:
        """Return what an episode aims for, and its preference; None and no preference if it explores.

        Args:
            rng: for the draws.
            shares: class → share of the inserted vehicles if nothing is predicted.
            count: number of classes to draw.
        """
        if self.probe is not None:
            kind = probed_kind(self.probe)
            agenda = Agenda(tuple(dict.fromkeys((kind, "hard-stop"))), crosses_any_time=False)
            wanted = Wanted(agenda, (probed_class(self.probe),) * count, oncoming=bool(self.probe % 2))
            return wanted, replace(self, exploration_share=1.0)
        if rng.random() < self.exploration_share:
            return None, replace(self, exploration_share=1.0)
        return self._wanted(rng, shares, count), self

    def _wanted(self, rng: np.random.Generator, shares: Mapping[AgentClass, float], count: int) -> Wanted:
        weights = self._weights(shares)
        by_kind, by_class = weights.sum(axis=(1, 2)), weights.sum(axis=(0, 2))
        least = _CROSSING_SHARE**_PREFERENCE_POWER * by_kind.max()
        by_direction = weights[TURNING_KINDS.index("crossing")].sum(axis=0)
        cut_outs = int(rng.random() < by_kind[0] / by_kind.sum())  # possible only at the first instant
        turns = rng.choice(TURNING_KINDS[1:], size=_TURNS, p=by_kind[1:] / by_kind[1:].sum()).tolist()
        not_drawn = [kind for kind in TURNING_KINDS[1:] if kind not in turns]
        classes = rng.choice(len(shares), size=count, p=by_class / by_class.sum()).tolist()
        return Wanted(
            Agenda(
                (*TURNING_KINDS[:cut_outs], *turns, *not_drawn),
                crosses_any_time=bool(by_kind[TURNING_KINDS.index("crossing")] >= least),
            ),
            tuple([*shares][k] for k in classes),
            oncoming=bool(rng.random() < by_direction[1] / by_direction.sum()),
        )

    def _weights(self, shares: Mapping[AgentClass, float]) -> FloatArray:
        """Return (K, C, 2) weights of each of ``TURNING_KINDS`` with each class, from the side and from ahead."""
        predicted = [
            [
                [self.predicted_failures(kind, agent_class, oncoming) for oncoming in (False, True)]
                for agent_class in shares
            ]
            for kind in TURNING_KINDS
        ]
        powers = np.array(predicted) ** _PREFERENCE_POWER
        return np.asarray(powers * np.array([*shares.values()])[:, None] / 2.0)


@dataclass(frozen=True)
class Wanted:
    """What an episode aims for.

    Attributes:
        agenda: kinds in the order of their turns.
        classes: classes of the vehicles that are inserted, in their order.
        oncoming: whether vehicles with priority come from ahead rather than from the side.
    """

    agenda: Agenda
    classes: tuple[AgentClass, ...]
    oncoming: bool


def probed_kind(probe: int) -> str:
    """Return the kind of manoeuvre that is tried in probe number *probe* of a warm-up."""
    return _PROBES[probe % len(_PROBES)]


def probed_class(probe: int) -> AgentClass:
    """Return the class of the vehicles that are inserted in probe number *probe* of a warm-up."""
    return _CLASSES[probe % len(_CLASSES)]


def is_probed(probe: int, features: FloatArray) -> bool:
    """Return whether one of the encounters with *features* (N, D) has the kind and vehicle of probe number *probe*."""
    is_kind = features[:, FEATURES.index(probed_kind(probe))] == 1.0
    is_class = (features == with_vehicle(features, probed_class(probe))).all(axis=-1)
    return bool((is_kind & is_class).any())
