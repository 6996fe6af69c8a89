"""Reuse plans of a background policy that this process has made before.

A policy keeps nothing between calls: its plan follows from the scenes of the episode so far and its random numbers.
Episodes of one seed scene with a planner, and with the same planner and a defect, therefore have the same plans until
the defect has an effect. The second episode reuses them.
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

_MAX_FUTURES = 50_000  # of some 0.5 kB each: 24 episodes of 60 plans for 30 vehicles


@dataclass(frozen=True)
class MadePlan:
    """A plan and all that was changed by making it.

    Attributes:
        plan: as the policy returned it.
        memory: of the policy afterwards.
        random: state of the policy's random generator afterwards.
        wall_s: wall-clock time that it took.
        cpu_s: processor time that it took.
    """

    plan: JointPlan
    memory: Any
    random: Mapping[str, Any]
    wall_s: float
    cpu_s: float


class KeptPlans:
    """The plans used last, by a digest of everything that they depend on.

    Args:
        most: largest number of vehicles' futures that are kept.
    """

    def __init__(self, most: int = _MAX_FUTURES) -> None:
        self._max_futures, self._futures = most, 0
        self._made = OrderedDict[bytes, MadePlan]()

    def get(self, key: bytes) -> MadePlan | None:
        """Return the plan of *key*; None if it is not kept."""
        kept = self._made.get(key)
        if kept is not None:
            self._made.move_to_end(key)
        return kept

    def keep(self, key: bytes, kept: MadePlan) -> None:
        """Keep *kept* under the new *key*; if there is no room, drop the plans that were not used for longest."""
        self._made[key] = kept
        self._futures += kept.plan.tracks.agents + 1
        while self._futures > self._max_futures:
            self._futures -= self._made.popitem(last=False)[1].plan.tracks.agents + 1


@dataclass(frozen=True)
class PlanMemo:
    """The kept plans of one policy with its options on one net.

    Attributes:
        about: net, policy, options and the state of files that they name.
        made: plans of this process, also of other policies and nets.
    """

    about: tuple[Any, ...]
    made: KeptPlans


@dataclass
class PlanSource:
    """Source of an episode's plans: those made before if they are kept, else the policy.

    The policy gets copies, which it may change.

    Attributes:
        policy: makes the plans.
        memo: of this process; None: each plan is made.
        memory: of the policy; None before the start.
        spared_s: wall-clock time that the reused plans once took.
        spared_cpu_s: processor time that they once took.
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
            key_parts = (
                repr(self.memo.about).encode(),
                *_tracks_bytes(log),
                *_scene_bytes(scene),
                _rng_bytes(rng),
            )
            self._key = _digest(key_parts)
        self.memory = self.policy.start(road, scene.copied(), log.copied(), rng)

    def plan(
        self, road: RoadMap, scene: Scene, rng: np.random.Generator, owner: str
    ) -> tuple[JointPlan, float]:
        """Return the plan for *scene*, and the wall-clock time that it took when it was made.

        Raises:
            PlanRefusedError: the policy, *owner* in the message, returned something else.
        """
        if self.memo is not None:
            self._key = _digest((self._key, *_scene_bytes(scene), _rng_bytes(rng)))
            kept = self.memo.made.get(self._key)
            if kept is not None:
                return self._reuse(kept, rng)
        scene_copy = scene.copied()
        started_s, cpu_started_s = time.perf_counter(), time.process_time()
        answer: Any = self.policy.plan(road, scene_copy, self.memory, rng)
        wall_s, cpu_s = time.perf_counter() - started_s, time.process_time() - cpu_started_s
        if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[0], JointPlan)):
            raise PlanRefusedError(f"{owner} returned {_type_text(answer)}, not (JointPlan, memory)")
        plan, self.memory = answer
        if self.memo is not None:
            self.memo.made.keep(
                self._key, MadePlan(plan, self.memory, rng.bit_generator.state, wall_s, cpu_s)
            )
        return plan, wall_s

    def _reuse(self, kept: MadePlan, rng: np.random.Generator) -> tuple[JointPlan, float]:
        """Set memory and random generator to what they were after *kept* was made, and return its plan."""
        self.memory, rng.bit_generator.state = kept.memory, dict(kept.random)
        self.spared_s += kept.wall_s
        self.spared_cpu_s += kept.cpu_s
        return kept.plan, kept.wall_s


def _digest(parts: Iterable[bytes]) -> bytes:
    digest = blake2b(digest_size=16)
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.digest()


def _scene_bytes(scene: Scene) -> Iterable[bytes]:
    yield from _tracks_bytes(scene.history)
    yield scene.movable.tobytes()
    yield repr((scene.target, scene.routes, sorted(scene.signals.items()))).encode()


def _tracks_bytes(tracks: Tracks) -> Iterable[bytes]:
    for value in (getattr(tracks, attribute.name) for attribute in fields(tracks)):
        yield value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()


def _rng_bytes(rng: np.random.Generator) -> bytes:
    return repr(rng.bit_generator.state).encode()


def _type_text(answer: object) -> str:
    """Return the name of the type of *answer*; of a tuple, those of its members."""
    if isinstance(answer, tuple):
        return f"({', '.join(type(member).__name__ for member in answer)})"
    return type(answer).__name__
