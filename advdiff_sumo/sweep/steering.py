"""Choose the next episodes of a diverse sweep: those likely to fill empty cells of its archive.

The chance that an episode fills a cell is a product of three factors, each from smoothed counts:

1. the chance of a valid failure: by target, net and requested kind of attack, by how often a vehicle could attack
   there, and by how often one could attack in that seed scene;
2. the chance of the observed kind of attack and approach: by target and requested kind;
3. the chance of the target's manoeuvre: by seed scene once it has been driven, else by net.

Episodes are picked one by one. Each reduces the emptiness of the cells by its chance of filling them. All depends
on the results of earlier rounds only, not on the workers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias, TypeVar

from advdiff_sumo.metrics.archive import ANY, APPROACHES, MANOEUVRES, ArchiveCell, cell_of
from advdiff_sumo.metrics.severity import is_failure, is_valid_failure

Row: TypeAlias = Mapping[str, Any]
_Name = TypeVar("_Name")

_FIRST_FAILURES, _FIRST_EPISODES = 1.0, 3.0
"""Added to the counts of valid failures and episodes, so that rarely tried kinds are tried."""
_SMOOTHING = 0.1
"""Added to the count of each approach and manoeuvre."""
_NEAR_MISS = 0.5
"""Weight of a critical near miss; a valid failure has weight 1."""
_SAME_MANOEUVRE = 0.8
"""Chance that a target repeats its earlier manoeuvre in a seed scene."""


class Arm(NamedTuple):
    """A class of episodes that cannot be told apart before they are run.

    Attributes:
        target: target with its options.
        net: the net.
        kind: requested kind of attack.
        manoeuvre: the target's manoeuvre in that seed scene; "" if it has not been driven yet.
        tried: episodes of that seed scene and target that were run or picked.
        met: those of them in which a vehicle could attack.
    """

    target: str
    net: str
    kind: str
    manoeuvre: str
    tried: int
    met: int


@dataclass(frozen=True)
class Candidate:
    """An episode that could be run.

    Attributes:
        key: key of the episode.
        target: target with its options.
        net: the net.
        kind: requested kind of attack.
        scene: key of its seed scene.
    """

    key: str
    target: str
    net: str
    kind: str
    scene: str


@dataclass
class Steering:
    """Counts from the results so far.

    Attributes:
        episodes: (target, net, kind) → episodes that were run or picked.
        attacked: (target, net, kind) → those in which a vehicle could attack.
        failures: (target, net, kind) → valid failures, plus near misses with half weight.
        outcomes: (target, requested kind) → (observed kind, approach) → count.
        manoeuvres: net → manoeuvre of the target → count.
        driven: (target, seed scene) → manoeuvre of the target.
        tried: (target, seed scene) → episodes that were run or picked.
        met: (target, seed scene) → those in which a vehicle could attack.
        emptiness: (target, cell) → chance that the cell is still empty; 1 if absent.
        kinds: kinds of the candidates; an episode of kind "any" may have any of them.
    """

    episodes: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    attacked: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    failures: dict[tuple[str, str, str], float] = field(default_factory=dict)
    outcomes: dict[tuple[str, str], Counter[tuple[str, str]]] = field(default_factory=dict)
    manoeuvres: dict[str, Counter[str]] = field(default_factory=dict)
    driven: dict[tuple[str, str], str] = field(default_factory=dict)
    tried: Counter[tuple[str, str]] = field(default_factory=Counter)
    met: Counter[tuple[str, str]] = field(default_factory=Counter)
    emptiness: dict[tuple[str, ArchiveCell], float] = field(default_factory=dict)
    kinds: tuple[str, ...] = ()

    @staticmethod
    def after(results: Iterable[tuple[Candidate, Row | None]]) -> Steering:
        """Return the counts from the *results* of episodes; None stands for an episode without a row."""
        steering = Steering()
        for candidate, row in results:
            steering._learn(candidate, row)
        return steering

    def _learn(self, candidate: Candidate, row: Row | None) -> None:
        """Count one result."""
        target = candidate.target
        arm_key, scene = (target, candidate.net, candidate.kind), (target, candidate.scene)
        self.episodes[arm_key] += 1
        self.tried[scene] += 1
        if row is None or is_failure(row):
            return
        self.manoeuvres.setdefault(candidate.net, Counter())[row["target_manoeuvre"]] += 1
        self.driven[scene] = row["target_manoeuvre"]
        cell = cell_of(row)
        if cell is None:
            return
        self.met[scene] += 1
        self.attacked[arm_key] += 1
        outcomes = self.outcomes.setdefault((candidate.target, candidate.kind), Counter())
        outcomes[cell.kind, cell.approach] += 1
        weight = 1.0 if is_valid_failure(row) else _NEAR_MISS if row["critical"] else 0.0
        self.failures[arm_key] = self.failures.get(arm_key, 0.0) + weight
        if weight == 1.0:
            self.emptiness[candidate.target, cell] = 0.0

    def pick(self, candidates: Sequence[Candidate], count: int) -> list[str]:
        """Return the keys of the *count* most promising *candidates*, which must be in the sweep's order."""
        remaining = dict.fromkeys(candidates)
        self.kinds = tuple(dict.fromkeys(candidate.kind for candidate in candidates if candidate.kind != ANY))
        chosen: list[str] = []
        while remaining and len(chosen) < count:
            promise_of: dict[Arm, float] = {}
            for candidate in remaining:
                arm = self._arm(candidate)
                if arm not in promise_of:
                    promise_of[arm] = self._promise(arm)
            best = max(remaining, key=lambda option: promise_of[self._arm(option)])  # the first of equals
            chosen.append(best.key)
            self._expect(best)
            del remaining[best]
        return chosen

    def _arm(self, candidate: Candidate) -> Arm:
        """Return the arm of *candidate*."""
        scene = (candidate.target, candidate.scene)
        manoeuvre = self.driven.get(scene, "")
        history = manoeuvre, self.tried[scene], self.met[scene]
        return Arm(candidate.target, candidate.net, candidate.kind, *history)

    def _promise(self, arm: Arm) -> float:
        """Return the expected number of empty cells that an episode of *arm* fills."""
        return sum(p * self.emptiness.get((arm.target, cell), 1.0) for cell, p in self._chances(arm))

    def _expect(self, candidate: Candidate) -> None:
        """Count *candidate* as picked, and reduce the emptiness of the cells that it may fill."""
        arm = self._arm(candidate)
        chances = list(self._chances(arm))
        for cell, chance in chances:
            self.emptiness[arm.target, cell] = self.emptiness.get((arm.target, cell), 1.0) * (1.0 - chance)
        self.episodes[arm.target, arm.net, arm.kind] += 1
        self.tried[candidate.target, candidate.scene] += 1

    def _chances(self, arm: Arm) -> Iterable[tuple[ArchiveCell, float]]:
        """Yield each cell with the chance that an episode of *arm* fails validly in it."""
        arm_key = (arm.target, arm.net, arm.kind)
        attacked = self.attacked[arm_key]
        p_failure = (self.failures.get(arm_key, 0.0) + _FIRST_FAILURES) / (attacked + _FIRST_EPISODES)
        p_failure *= (attacked + 1.0) / (self.episodes[arm_key] + 1.0) * (arm.met + 1.0) / (arm.tried + 1.0)
        observed = self.outcomes.get((arm.target, arm.kind), Counter())
        kinds = (arm.kind,) if arm.kind != ANY else self.kinds
        expected = [(kind, approach) for kind in kinds for approach in APPROACHES]
        outcomes = _shares(observed, list(dict.fromkeys((*expected, *observed))))
        manoeuvres = _shares(self.manoeuvres.get(arm.net, Counter()), MANOEUVRES)
        if arm.manoeuvre:
            manoeuvres = {
                name: _SAME_MANOEUVRE * (name == arm.manoeuvre) + (1.0 - _SAME_MANOEUVRE) * share
                for name, share in manoeuvres.items()
            }
        for (kind, approach), p_outcome in outcomes.items():
            for manoeuvre, p_manoeuvre in manoeuvres.items():
                yield ArchiveCell(kind, approach, manoeuvre), p_failure * p_outcome * p_manoeuvre


def _shares(counts: Counter[_Name], names: Sequence[_Name]) -> dict[_Name, float]:
    """Return the smoothed share of each name."""
    total = sum(counts[name] for name in names) + _SMOOTHING * len(names)
    return {name: (counts[name] + _SMOOTHING) / total for name in names}
