"""Whether a background policy may be used: its contract in scenes of real traffic and in hard ones, and its traffic."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import PlanRefusedError, SceneError
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.record import Controller, EpisodeRecord
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.wording import counted
from advdiff_sumo.experiments.check_results import (
    IN_TIME,
    CheckResult,
    contract_results,
    drives_results,
    evenly_spaced,
    in_time,
)
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.plausibility import implausibilities
from advdiff_sumo.planners.hard_scenes import hard_scenes_of_traffic
from advdiff_sumo.sim.run_episodes import Run, RunOptions
from advdiff_sumo.traffic.policy_check import PolicyPart, plans_from_memory_of_others, policy_problems
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy, moves_everywhere
from advdiff_sumo.traffic.sumo_traffic import plans_nothing

IN_TRAFFIC = "in traffic"


@dataclass(frozen=True)
class PlanningInstant:
    """A scene in which plans are made, with the log of its episode."""

    scene: Scene
    log: Tracks | None


@dataclass
class WatchedPolicy:
    """A policy whose scenes are kept, also that in which it raises as an episode starts."""

    policy: TrafficPolicy
    starts: list[PlanningInstant] = field(default_factory=list)
    plans: list[PlanningInstant] = field(default_factory=list)

    @property
    def everywhere(self) -> bool:
        """Whether the control radius does not bind the policy."""
        return moves_everywhere(self.policy)

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        """Keep scene and log, and pass the call on."""
        self.starts.append(PlanningInstant(scene.copied(), log and log.copied()))
        return self.policy.start(road, scene, log, rng)

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        """Keep the scene, and pass the call on."""
        self.plans.append(PlanningInstant(scene.copied(), self.starts[-1].log))
        return self.policy.plan(road, scene, memory, rng)


@dataclass(frozen=True)
class DrivenTraffic:
    """What the episodes came to.

    Attributes:
        records: of the episodes.
        again: record of the first one, run again.
        plans_s: wall-clock seconds of each plan.
        instants: at which it planned, or began to where it never did.
    """

    records: tuple[EpisodeRecord, ...]
    again: EpisodeRecord
    plans_s: FloatArray
    instants: tuple[PlanningInstant, ...]


def check_background(options: RunOptions, within_ms: float = math.inf) -> list[CheckResult]:
    """Return the verdicts on the background policy of a run.

    Args:
        options: of the run, with the policy, its options, and how many episodes of what length.
        within_ms: longest median time of a plan.

    Raises:
        InputError: there is no such policy, it cannot be made, or the run cannot start.
    """
    run = Run.prepare(options)
    driven = drive_traffic(run)
    instants = _instants(driven.instants)
    contract = _contract(run.policy, run.road, instants)
    drives = drives_results(driven.records, driven.again)
    return [*contract, *drives, _in_traffic(driven.records, run), _in_time(run.policy, driven, within_ms)]


def drive_traffic(run: Run) -> DrivenTraffic:
    """Run the episodes, the first one twice.

    Raises:
        SceneError: there is no seed scene.
    """
    watched = WatchedPolicy(run.policy)
    starts = run.scene_batch(0, run.options.episodes)
    if not starts:
        raise SceneError(run.why_no_scene())
    ran = [replace(run, policy=watched).episode(k, start).run() for k, start in enumerate(starts)]
    again, _ = run.episode(0, starts[0]).run()
    times = np.array([took for _, timing in ran for took in timing.background_plans_s])
    return DrivenTraffic(
        tuple(record for record, _ in ran), again, times, tuple(watched.plans or watched.starts)
    )


def _instants(seen: Sequence[PlanningInstant]) -> dict[str, PlanningInstant]:
    """Return instants of the episodes, evenly taken, and hard ones made of the first."""
    if not seen:
        return {}
    picked = {
        f"{k}, {one.scene.time_s:.1f} s into an episode": one for k, one in enumerate(evenly_spaced(seen), 1)
    }
    first = seen[0]
    hard = hard_scenes_of_traffic(first.scene)
    return picked | {name: PlanningInstant(scene, _fitting(first, scene)) for name, scene in hard.items()}


def _fitting(first: PlanningInstant, changed: Scene) -> Tracks | None:
    """Return the log without those whom *changed* has elsewhere."""
    if first.log is None:
        return None
    before, now = first.scene.history, changed.history
    both = [name for name in before.ids if name in now.index]
    moved = {
        name
        for name in both
        if not np.array_equal(before.xy_m[before.index[name], -1], now.xy_m[now.index[name], -1])
    }
    return first.log.rows(np.array([name not in moved for name in first.log.ids], dtype=np.bool_))


def _contract(
    policy: TrafficPolicy, road: RoadMap, instants: Mapping[str, PlanningInstant]
) -> list[CheckResult]:
    problems = [
        (where, problem)
        for where, one in instants.items()
        for problem in policy_problems(policy, road, one.scene.copied(), one.log and one.log.copied())
    ]
    pairs = [(one.scene, one.log) for one in instants.values()]
    remembers = bool(pairs) and plans_from_memory_of_others(policy, road, pairs)
    return contract_results(PolicyPart, problems, instants, remembers)


def _in_traffic(records: Sequence[EpisodeRecord], run: Run) -> CheckResult:
    """Return counts of what the contract does not forbid; they are told, not judged."""
    faults = [fault for record in records for fault in implausibilities(record, run.road)]
    collisions = sum(fault.what in ("collision", "drove through") for fault in faults)
    departures = sum(fault.what == "off the road" for fault in faults)
    refused = sum(
        record.failure is not None and record.failure.kind == PlanRefusedError.kind for record in records
    )
    moved = sum(int((record.controller == Controller.POLICY).any(axis=1).sum()) for record in records)
    changed, looked_at = np.sum([record.safeguarded for record in records], axis=0).tolist()
    words = [
        f"{counted(moved, 'vehicle')} moved",
        counted(refused, "refused plan"),
        f"safeguard changed {changed} of {counted(looked_at, 'plan')}" if looked_at else "no safeguard",
        f"{counted(collisions, 'collision')} of background vehicles",
        counted(departures, "road departure"),
    ]
    clean = not (refused or collisions or departures)
    remedy = "" if clean else f"; advdiff-sumo run --background {run.names[1]} --check names each"
    return CheckResult(IN_TRAFFIC, True if clean else None, ", ".join(words) + remedy)


def _in_time(policy: TrafficPolicy, driven: DrivenTraffic, within_ms: float) -> CheckResult:
    if plans_nothing(policy):
        return CheckResult(IN_TIME, True, "it plans nothing: SUMO drives everybody")
    return in_time(driven.plans_s, within_ms)
