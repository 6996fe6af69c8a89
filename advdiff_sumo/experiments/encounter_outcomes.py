"""What came of the encounters of an episode: the target failed validly, nearly so, or resolved them calmly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.criticality import time_to_collision
from advdiff_sumo.metrics.verdict import judge
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionMemory
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy

NEAR_S, NEAR_WORTH = 0.5, 0.5
"""A time to collision below this is a share of a failure, at most so large."""
_LASTS_S, _LEAST_S = 9.0, 2.5


@dataclass(frozen=True)
class BegunEncounter:
    """An encounter that has begun.

    Attributes:
        since_s: when, since the episode's start.
        names: who drives the manoeuvre, and who stands and is revealed by it.
        features: (D,) see ``encounter_features``.
    """

    since_s: float
    names: tuple[str, ...]
    features: tuple[float, ...]


@dataclass(frozen=True)
class EncounterLog:
    """A policy as it is, with notes on the encounters that it begins.

    Attributes:
        policy: "scripted" or "diffusion", with a preference.
        begun: encounters of the present episode.
        plans: number of its plans.
    """

    policy: TrafficPolicy
    begun: list[BegunEncounter] = field(default_factory=list)
    plans: list[float] = field(default_factory=list)

    def forget(self) -> None:
        """Forget the last episode."""
        self.begun.clear()
        self.plans.clear()

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        """Forget the last episode, and start the policy."""
        self.forget()
        return self.policy.start(road, scene, log, rng)

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        """Return the policy's plan."""
        plan, after = self.policy.plan(road, scene, memory, rng)
        before = _commitments(memory)
        self.plans.append(scene.time_s)
        for name, one in _commitments(after).active.items():
            began = before.active.get(name) != one and one.since_s == scene.time_s
            if one.features and not one.sets_up and began:
                names = (name, *before.standing.names) if one.kind == "cut-out" else (name,)
                self.begun.append(BegunEncounter(one.since_s, names, one.features))
        return plan, after


def _commitments(memory: Any) -> Commitments:
    kept = memory.commitments if isinstance(memory, DiffusionMemory) else memory
    return kept if isinstance(kept, Commitments) else Commitments({})


def outcomes(
    record: EpisodeRecord, road: RoadMap, begun: Sequence[BegunEncounter]
) -> tuple[list[BegunEncounter], FloatArray]:
    """Return the encounters that came to an end, and (N,) what came of each.

    1: the target failed validly against one of them; up to ``NEAR_WORTH``: less than ``NEAR_S`` were left to a contact;
    0: it resolved it. One that the episode's end cut off, and one that ended in a collision that is no valid failure,
    do not count.
    """
    hit = target_collision(record, collisions(record))
    struck = None if hit is None else record.tracks.ids[hit.rows[1]]
    failed = hit is not None and judge(record, road, hit).valid_failure
    ttc = time_to_collision(record.tracks, record.target)
    times = np.asarray(record.tracks.t0_s + record.tracks.dt_s * np.arange(record.tracks.steps), np.float64)
    ended: list[BegunEncounter] = []
    out: list[float] = []
    for k, one in enumerate(begun):
        again = [other.since_s for other in begun[k + 1 :] if {*other.names} & {*one.names}]
        until = min(one.since_s + _LASTS_S, float(times[-1]), *again)
        if struck in one.names and not again:
            came = 1.0 if failed else None
        else:
            came = _nearly(record, ttc, times, one, until) if until - one.since_s >= _LEAST_S else None
        if came is not None:
            ended.append(one)
            out.append(came)
    return ended, np.array(out)


def _nearly(
    record: EpisodeRecord, ttc_s: FloatArray, times_s: FloatArray, one: BegunEncounter, until_s: float
) -> float:
    """Return which share of a failure it was that so little time (A, T) was left to a contact at times (T,)."""
    rows = [record.tracks.index[name] for name in one.names if name in record.tracks.index]
    during = (times_s > one.since_s) & (times_s <= until_s)
    least = float(np.nanmin(ttc_s[rows][:, during], initial=np.inf))
    return NEAR_WORTH * float(np.clip(1.0 - least / NEAR_S, 0.0, 1.0))
