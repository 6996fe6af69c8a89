"""Rates the encounters of an episode: valid failure, near miss, or resolved calmly."""

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
"""A time to collision below ``NEAR_S`` counts as a partial failure, of at most ``NEAR_WORTH`` (at 0 s)."""
_LONGEST_S = 9.0
"""An encounter ends this long after its begin at the latest."""
_SHORTEST_S = 2.5
"""An encounter without collision that was observed for less time does not count."""


@dataclass(frozen=True)
class BegunEncounter:
    """An encounter that has begun.

    Attributes:
        since_s: time of its begin, since the episode's start.
        names: ids of the vehicle that drives the manoeuvre and, for a cut-out, of the vehicles it reveals.
        features: (D,) see ``encounter_features``.
    """

    since_s: float
    names: tuple[str, ...]
    features: tuple[float, ...]


@dataclass(frozen=True)
class EncounterLog:
    """Wraps a policy, without changing its plans, and logs the encounters that it begins.

    Attributes:
        policy: "scripted" or "diffusion", with a preference.
        begun: encounters of the present episode.
        plans: times of its plans (s).
    """

    policy: TrafficPolicy
    begun: list[BegunEncounter] = field(default_factory=list)
    plans: list[float] = field(default_factory=list)

    def forget(self) -> None:
        """Clear the log of the last episode."""
        self.begun.clear()
        self.plans.clear()

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        """Clear the log of the last episode and start the policy."""
        self.forget()
        return self.policy.start(road, scene, log, rng)

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        """Return the policy's plan, and log the encounters that begin with it."""
        plan, new_memory = self.policy.plan(road, scene, memory, rng)
        previous = _commitments(memory)
        self.plans.append(scene.time_s)
        for name, commitment in _commitments(new_memory).active.items():
            began = previous.active.get(name) != commitment and commitment.since_s == scene.time_s
            if commitment.features and not commitment.is_positioning and began:
                names = (name, *previous.standing.names) if commitment.kind == "cut-out" else (name,)
                self.begun.append(BegunEncounter(commitment.since_s, names, commitment.features))
        return plan, new_memory


def _commitments(memory: Any) -> Commitments:
    commitments = memory.commitments if isinstance(memory, DiffusionMemory) else memory
    return commitments if isinstance(commitments, Commitments) else Commitments({})


def outcomes(
    record: EpisodeRecord, road: RoadMap, begun: Sequence[BegunEncounter]
) -> tuple[list[BegunEncounter], FloatArray]:
    """Return the completed encounters and the outcome (N,) of each.

    1: a valid failure of the target against a vehicle of the encounter. Above 0 and up to ``NEAR_WORTH``: the time to
    collision fell below ``NEAR_S``. 0: resolved. Encounters that the episode's end cuts off do not count, nor do those
    that end in a collision that is no valid failure.
    """
    collision = target_collision(record, collisions(record))
    partner_id = None if collision is None else record.tracks.ids[collision.rows[1]]
    failed = collision is not None and judge(record, road, collision).valid_failure
    ttc = time_to_collision(record.tracks, record.target)
    times = np.asarray(record.tracks.t0_s + record.tracks.dt_s * np.arange(record.tracks.steps), np.float64)
    ended: list[BegunEncounter] = []
    values: list[float] = []
    for k, encounter in enumerate(begun):
        repeated_s = [later.since_s for later in begun[k + 1 :] if {*later.names} & {*encounter.names}]
        until_s = min(encounter.since_s + _LONGEST_S, float(times[-1]), *repeated_s)
        if partner_id in encounter.names and not repeated_s:
            value = 1.0 if failed else None
        elif until_s - encounter.since_s >= _SHORTEST_S:
            value = _near_miss_outcome(record, ttc, times, encounter, until_s)
        else:
            value = None
        if value is not None:
            ended.append(encounter)
            values.append(value)
    return ended, np.array(values)


def _near_miss_outcome(
    record: EpisodeRecord, ttc_s: FloatArray, times_s: FloatArray, encounter: BegunEncounter, until_s: float
) -> float:
    """Return the partial failure of an encounter from its times to collision (A, T) at instants (T,) to *until_s*."""
    rows = [record.tracks.index[name] for name in encounter.names if name in record.tracks.index]
    during = (times_s > encounter.since_s) & (times_s <= until_s)
    least_ttc_s = float(np.nanmin(ttc_s[rows][:, during], initial=np.inf))
    return NEAR_WORTH * float(np.clip(1.0 - least_ttc_s / NEAR_S, 0.0, 1.0))
