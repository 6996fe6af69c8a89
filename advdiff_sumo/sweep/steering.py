"""Which episodes a diverse sweep runs next: those that are likely to fill empty cells of its archive.

The chance that an episode fills a cell is taken as that of a valid failure (by target, net and kind of attack) times
that of the approach (by target and kind) times that of the target's manoeuvre (by seed scene, once it has been driven,
else by net), each from smoothed counts. Episodes are picked one by one; each leaves the cells less empty by its chance
of filling them. All of it follows from the results of the rounds before, so that it does not depend on the workers.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

from advdiff_sumo.metrics.archive import APPROACHES, MANOEUVRES, ArchiveCell, cell_of
from advdiff_sumo.metrics.severity import is_valid_failure

Row: TypeAlias = Mapping[str, Any]

_FIRST_FAILURES, _FIRST_EPISODES = 1.0, 3.0
"""Added to the counts of valid failures and episodes: hardly tried kinds are worth a try."""
_SMOOTHING = 0.1
"""Added to the count of each approach and manoeuvre."""
_SAME_MANOEUVRE = 0.8
"""Chance that a target does in a seed scene what it did there before."""


class Arm(NamedTuple):
    """Episodes that are alike before they are run.

    Attributes:
        target: with its options.
        net: where.
        kind: of the attack.
        manoeuvre: of the target in that seed scene; "" where none of its episodes has been run.
    """

    target: str
    net: str
    kind: str
    manoeuvre: str


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
        failures: (target, net, kind) → valid failures.
        approaches: (target, kind) → approach → count.
        manoeuvres: net → manoeuvre → count.
        driven: seed scene → manoeuvre of the target.
        emptiness: (target, cell) → chance that it is still empty; 1 where absent.
    """

    episodes: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    failures: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    approaches: dict[tuple[str, str], Counter[str]] = field(default_factory=dict)
    manoeuvres: dict[str, Counter[str]] = field(default_factory=dict)
    driven: dict[str, str] = field(default_factory=dict)
    emptiness: dict[tuple[str, ArchiveCell], float] = field(default_factory=dict)

    @staticmethod
    def after(results: Iterable[tuple[Candidate, Row | None]]) -> Steering:
        """Return what the *results* of episodes say; None stands for one without a row."""
        steering = Steering()
        for candidate, row in results:
            steering._learn(candidate, row)
        return steering

    def _learn(self, candidate: Candidate, row: Row | None) -> None:
        place = (candidate.target, candidate.net, candidate.kind)
        self.episodes[place] += 1
        cell = None if row is None else cell_of(row)
        if row is None or cell is None:
            return
        self.approaches.setdefault((candidate.target, candidate.kind), Counter())[cell.approach] += 1
        self.manoeuvres.setdefault(candidate.net, Counter())[cell.manoeuvre] += 1
        self.driven[candidate.scene] = cell.manoeuvre
        if is_valid_failure(row):
            self.failures[place] += 1
            self.emptiness[candidate.target, cell] = 0.0

    def pick(self, candidates: Sequence[Candidate], count: int) -> list[str]:
        """Return the keys of the *count* most promising of *candidates*, which are in the sweep's order."""
        arms: dict[Arm, deque[str]] = {}
        for one in candidates:
            arm = Arm(one.target, one.net, one.kind, self.driven.get(one.scene, ""))
            arms.setdefault(arm, deque()).append(one.key)
        chosen: list[str] = []
        while arms and len(chosen) < count:
            best = max(arms, key=self._promise)  # the first of equals
            chosen.append(arms[best].popleft())
            if not arms[best]:
                del arms[best]
            self._expect(best)
        return chosen

    def _promise(self, arm: Arm) -> float:
        """Return how many empty cells an episode of *arm* is expected to fill."""
        return sum(share * self.emptiness.get((arm.target, cell), 1.0) for cell, share in self._chances(arm))

    def _expect(self, arm: Arm) -> None:
        """Count an episode of *arm* as run, with what it is expected to fill."""
        chances = list(self._chances(arm))
        for cell, share in chances:
            self.emptiness[arm.target, cell] = self.emptiness.get((arm.target, cell), 1.0) * (1.0 - share)
        self.episodes[arm.target, arm.net, arm.kind] += 1

    def _chances(self, arm: Arm) -> Iterable[tuple[ArchiveCell, float]]:
        """Yield (cell, chance that an episode of *arm* fails validly in it)."""
        place = (arm.target, arm.net, arm.kind)
        fails = (self.failures[place] + _FIRST_FAILURES) / (self.episodes[place] + _FIRST_EPISODES)
        approaches = _shares(self.approaches.get((arm.target, arm.kind), Counter()), APPROACHES)
        manoeuvres = _shares(self.manoeuvres.get(arm.net, Counter()), MANOEUVRES)
        if arm.manoeuvre:
            manoeuvres = {
                name: _SAME_MANOEUVRE * (name == arm.manoeuvre) + (1.0 - _SAME_MANOEUVRE) * share
                for name, share in manoeuvres.items()
            }
        for approach, likely in approaches.items():
            for manoeuvre, as_likely in manoeuvres.items():
                yield ArchiveCell(arm.kind, approach, manoeuvre), fails * likely * as_likely


def _shares(counts: Counter[str], names: Sequence[str]) -> dict[str, float]:
    total = sum(counts[name] for name in names) + _SMOOTHING * len(names)
    return {name: (counts[name] + _SMOOTHING) / total for name in names}
