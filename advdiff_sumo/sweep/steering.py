"""Which episodes a diverse sweep runs next: those that are likely to fill empty cells of its archive.

The chance that an episode fills a cell is taken as that of a valid failure (by target, net and kind of attack asked
for, and by how often somebody could attack then, and in that seed scene) times that of the kind met and the approach
(by target and kind asked for) times that of the target's manoeuvre (by seed scene, once it has been driven, else by
net), each from smoothed counts. Episodes are picked one by one; each leaves the cells less empty by its chance of
filling them. All of it follows from the results of the rounds before, so that it does not depend on the workers.
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
"""Added to the counts of valid failures and episodes: hardly tried kinds are worth a try."""
_SMOOTHING = 0.1
"""Added to the count of each approach and manoeuvre."""
_NEAR_MISS = 0.5
"""What a critical near miss counts beside a valid failure."""
_SAME_MANOEUVRE = 0.8
"""Chance that a target does in a seed scene what it did there before."""


class Arm(NamedTuple):
    """Episodes that are alike before they are run.

    Attributes:
        target: with its options.
        net: where.
        kind: of the attack.
        manoeuvre: of the target in that seed scene; "" where none of its episodes has been run.
        tried: episodes of that seed scene and target that were run, or are picked.
        met: those of them in which somebody could attack.
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
        key: of the episode.
        target: with its options.
        net: where.
        kind: of the attack.
        scene: key of its seed scene.
    """

    key: str
    target: str
    net: str
    kind: str
    scene: str


@dataclass
class Steering:
    """What the results so far say.

    Attributes:
        episodes: (target, net, kind) → how many were run, or are picked.
        attacked: (target, net, kind) → those in which somebody could attack.
        failures: (target, net, kind) → valid failures, and near misses at half their worth.
        outcomes: (target, kind asked for) → (kind met, approach) → count.
        manoeuvres: net → manoeuvre → count.
        driven: (target, seed scene) → manoeuvre of the target.
        tried: (target, seed scene) → episodes that were run, or are picked.
        met: (target, seed scene) → those in which somebody could attack.
        emptiness: (target, cell) → chance that it is still empty; 1 where absent.
        kinds: of the candidates, which an episode of "any" may come to.
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
        """Return what the *results* of episodes say; None stands for one without a row."""
        steering = Steering()
        for candidate, row in results:
            steering._learn(candidate, row)
        return steering

    def _learn(self, candidate: Candidate, row: Row | None) -> None:
        place, scene = (candidate.target, candidate.net, candidate.kind), (candidate.target, candidate.scene)
        self.episodes[place] += 1
        self.tried[scene] += 1
        if row is None or is_failure(row):
            return
        self.manoeuvres.setdefault(candidate.net, Counter())[row["target_manoeuvre"]] += 1
        self.driven[scene] = row["target_manoeuvre"]
        cell = cell_of(row)
        if cell is None:
            return
        self.met[scene] += 1
        self.attacked[place] += 1
        outcomes = self.outcomes.setdefault((candidate.target, candidate.kind), Counter())
        outcomes[cell.kind, cell.approach] += 1
        worth = 1.0 if is_valid_failure(row) else _NEAR_MISS if row["critical"] else 0.0
        self.failures[place] = self.failures.get(place, 0.0) + worth
        if worth == 1.0:
            self.emptiness[candidate.target, cell] = 0.0

    def pick(self, candidates: Sequence[Candidate], count: int) -> list[str]:
        """Return the keys of the *count* most promising of *candidates*, which are in the sweep's order."""
        left = dict.fromkeys(candidates)
        self.kinds = tuple(dict.fromkeys(one.kind for one in candidates if one.kind != ANY))
        chosen: list[str] = []
        while left and len(chosen) < count:
            promises: dict[Arm, float] = {}
            for one in left:
                arm = self._arm(one)
                if arm not in promises:
                    promises[arm] = self._promise(arm)
            best = max(left, key=lambda one: promises[self._arm(one)])  # the first of equals
            chosen.append(best.key)
            self._expect(best)
            del left[best]
        return chosen

    def _arm(self, one: Candidate) -> Arm:
        scene = (one.target, one.scene)
        driven = self.driven.get(scene, "")
        return Arm(one.target, one.net, one.kind, driven, self.tried[scene], self.met[scene])

    def _promise(self, arm: Arm) -> float:
        """Return how many empty cells an episode of *arm* is expected to fill."""
        return sum(share * self.emptiness.get((arm.target, cell), 1.0) for cell, share in self._chances(arm))

    def _expect(self, one: Candidate) -> None:
        """Count *one* as run, with what it is expected to fill."""
        arm = self._arm(one)
        chances = list(self._chances(arm))
        for cell, share in chances:
            self.emptiness[arm.target, cell] = self.emptiness.get((arm.target, cell), 1.0) * (1.0 - share)
        self.episodes[arm.target, arm.net, arm.kind] += 1
        self.tried[one.target, one.scene] += 1

    def _chances(self, arm: Arm) -> Iterable[tuple[ArchiveCell, float]]:
        """Yield (cell, chance that an episode of *arm* fails validly in it)."""
        place = (arm.target, arm.net, arm.kind)
        attacked = self.attacked[place]
        fails = (self.failures.get(place, 0.0) + _FIRST_FAILURES) / (attacked + _FIRST_EPISODES)
        fails *= (attacked + 1.0) / (self.episodes[place] + 1.0) * (arm.met + 1.0) / (arm.tried + 1.0)
        met = self.outcomes.get((arm.target, arm.kind), Counter())
        kinds = (arm.kind,) if arm.kind != ANY else self.kinds
        expected = [(kind, approach) for kind in kinds for approach in APPROACHES]
        outcomes = _shares(met, list(dict.fromkeys((*expected, *met))))
        manoeuvres = _shares(self.manoeuvres.get(arm.net, Counter()), MANOEUVRES)
        if arm.manoeuvre:
            manoeuvres = {
                name: _SAME_MANOEUVRE * (name == arm.manoeuvre) + (1.0 - _SAME_MANOEUVRE) * share
                for name, share in manoeuvres.items()
            }
        for (kind, approach), likely in outcomes.items():
            for manoeuvre, as_likely in manoeuvres.items():
                yield ArchiveCell(kind, approach, manoeuvre), fails * likely * as_likely


def _shares(counts: Counter[_Name], names: Sequence[_Name]) -> dict[_Name, float]:
    total = sum(counts[name] for name in names) + _SMOOTHING * len(names)
    return {name: (counts[name] + _SMOOTHING) / total for name in names}
