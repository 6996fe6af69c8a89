"""Plans of a background that this process has made before.

A policy keeps nothing between calls: its plan follows from the scenes of the episode so far and its random numbers.
So episodes of one seed scene against a planner and the same planner with a defect have the same plans until the
defect shows, and the second takes them from here.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from hashlib import blake2b
from typing import Any

import numpy as np

from advdiff_sumo.core.errors import PlanRefusedError
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy

_MOST = 50_000  # of some 0.5 kB each: 24 episodes of 60 plans for 30 vehicles


@dataclass(frozen=True)
class MadePlan:
    """A plan with all that its making changed.

    Attributes:
        plan: as the policy returned it.
        memory: of the policy afterwards.
        random: state of the policy's random numbers afterwards.
        wall_s: wall-clock that it took.
        cpu_s: processor time that it took.
    """

    plan: JointPlan
    memory: Any
    random: Mapping[str, Any]
    wall_s: float
    cpu_s: float


class KeptPlans:
    """The plans made last, by all that they follow from.

    Args:
        most: futures of vehicles that are kept.
    """

    def __init__(self, most: int = _MOST) -> None:
        self._most, self._futures = most, 0
        self._made = OrderedDict[bytes, MadePlan]()

    def get(self, key: bytes) -> MadePlan | None:
        """Return the plan of *key*, if it is kept."""
        kept = self._made.get(key)
        if kept is not None:
            self._made.move_to_end(key)
        return kept

    def keep(self, key: bytes, kept: MadePlan) -> None:
        """Keep *kept* under *key*, which is not kept, and drop what was used longest ago where there is no room."""
        self._made[key] = kept
        self._futures += kept.plan.tracks.agents + 1
        while self._futures > self._most:
            self._futures -= self._made.popitem(last=False)[1].plan.tracks.agents + 1


@dataclass(frozen=True)
class PlanMemo:
    """The plans of a policy with its options on a net.

    Attributes:
        about: net, policy, options and the state of files that they name.
        made: by this process, with those of other policies and nets.
    """

    about: tuple[Any, ...]
    made: KeptPlans


@dataclass
class PlanSource:
    """What an episode's plans come from: the memo, or else the policy, which is given copies of its own.

    Attributes:
        policy: makes the plans.
        memo: of this process; None: each plan is made.
        memory: of the policy; None before the start.
        spared_s: wall-clock that the plans took which were not made again.
        spared_cpu_s: the same in processor time.
    """

    policy: TrafficPolicy
    memo: PlanMemo | None = None
    memory: Any = None
    spared_s: float = 0.0
    spared_cpu_s: float = 0.0
    _key: bytes = field(default=b"", init=False)

    def start(self, road: RoadMap, scene: Scene, log: Tracks, rng: np.random.Generator) -> None:
        """Let the policy prepare for an episode that begins in *scene*."""
        if self.memo is not None:
            begins = repr(self.memo.about).encode(), *_of_tracks(log), *_of_scene(scene), _of_random(rng)
            self._key = _digest(begins)
        self.memory = self.policy.start(road, scene.copied(), log.copied(), rng)

    def plan(
        self, road: RoadMap, scene: Scene, rng: np.random.Generator, who: str
    ) -> tuple[JointPlan, float]:
        """Return the plan for *scene*, and the wall-clock that it took when it was made.

        Raises:
            PlanRefusedError: the policy, *who* in the message, returned something else.
        """
        if self.memo is not None:
            self._key = _digest((self._key, *_of_scene(scene), _of_random(rng)))
            kept = self.memo.made.get(self._key)
            if kept is not None:
                return self._again(kept, rng)
        given = scene.copied()
        begun, used = time.perf_counter(), time.process_time()
        answer: Any = self.policy.plan(road, given, self.memory, rng)
        wall_s, cpu_s = time.perf_counter() - begun, time.process_time() - used
        if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[0], JointPlan)):
            raise PlanRefusedError(f"{who} returned {type(answer).__name__}, not (JointPlan, memory)")
        plan, self.memory = answer
        if self.memo is not None:
            self.memo.made.keep(
                self._key, MadePlan(plan, self.memory, rng.bit_generator.state, wall_s, cpu_s)
            )
        return plan, wall_s

    def _again(self, kept: MadePlan, rng: np.random.Generator) -> tuple[JointPlan, float]:
        self.memory, rng.bit_generator.state = kept.memory, dict(kept.random)
        self.spared_s += kept.wall_s
        self.spared_cpu_s += kept.cpu_s
        return kept.plan, kept.wall_s


def _digest(parts: Iterable[bytes]) -> bytes:
    summed = blake2b(digest_size=16)
    for part in parts:
        summed.update(len(part).to_bytes(8, "little"))
        summed.update(part)
    return summed.digest()


def _of_scene(scene: Scene) -> Iterable[bytes]:
    yield from _of_tracks(scene.history)
    yield scene.movable.tobytes()
    yield repr((scene.target, scene.routes, sorted(scene.signals.items()))).encode()


def _of_tracks(tracks: Tracks) -> Iterable[bytes]:
    for part in (getattr(tracks, one.name) for one in fields(tracks)):
        yield part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode()


def _of_random(rng: np.random.Generator) -> bytes:
    return repr(rng.bit_generator.state).encode()
