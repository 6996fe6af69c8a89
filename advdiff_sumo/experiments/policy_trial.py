"""Checks a background policy: its contract in scenes of real traffic and in hard scenes, and its traffic in SUMO."""

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
    """A scene in which the policy plans or starts, with the log of its episode."""

    scene: Scene
    log: Tracks | None


@dataclass
class WatchedPolicy:
    """Wraps a policy and stores its scenes, also one in which it raises an error as an episode starts."""

    policy: TrafficPolicy
    starts: list[PlanningInstant] = field(default_factory=list)
    plans: list[PlanningInstant] = field(default_factory=list)

    @property
    def everywhere(self) -> bool:
        """Whether the control radius does not bind the policy."""
        return moves_everywhere(self.policy)

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        """Store scene and log, and pass the call on."""
        self.starts.append(PlanningInstant(scene.copied(), log and log.copied()))
        return self.policy.start(road, scene, log, rng)

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        """Store the scene, and pass the call on."""
        self.plans.append(PlanningInstant(scene.copied(), self.starts[-1].log))
        return self.policy.plan(road, scene, memory, rng)


@dataclass(frozen=True)
class DrivenTraffic:
    """The results of the episodes.

    Attributes:
        records: of the episodes.
        again: record of the first episode, run a second time.
        plans_s: wall-clock seconds of each plan.
        instants: at which the policy planned; if it never did, the starts of the episodes.
    """

    records: tuple[EpisodeRecord, ...]
    again: EpisodeRecord
    plans_s: FloatArray
    instants: tuple[PlanningInstant, ...]


def check_background(options: RunOptions, within_ms: float = math.inf) -> list[CheckResult]:
    """Check the background policy of a run.

    Args:
        options: of the run: the policy, its options, number and length of the episodes.
        within_ms: longest permitted median time of a plan.

    Raises:
        InputError: there is no such policy, it cannot be made, or the run cannot start.
    """
    run = Run.prepare(options)
    traffic = drive_traffic(run)
    instants = _instants(traffic.instants)
    contract = _contract(run.policy, run.road, instants)
    drives = drives_results(traffic.records, traffic.again)
    return [*contract, *drives, _in_traffic(traffic.records, run), _in_time(run.policy, traffic, within_ms)]


def drive_traffic(run: Run) -> DrivenTraffic:
    """Run the episodes; the first one is run twice.

    Raises:
        SceneError: there is no seed scene.
    """
    watched = WatchedPolicy(run.policy)
    seed_scenes = run.scene_batch(0, run.options.episodes)
    if not seed_scenes:
        raise SceneError(run.why_no_scene())
    results = [replace(run, policy=watched).episode(k, start).run() for k, start in enumerate(seed_scenes)]
    repeated, _ = run.episode(0, seed_scenes[0]).run()
    plans_s = np.array([took for _, timing in results for took in timing.background_plans_s])
    return DrivenTraffic(
        tuple(record for record, _ in results), repeated, plans_s, tuple(watched.plans or watched.starts)
    )


def _instants(observed: Sequence[PlanningInstant]) -> dict[str, PlanningInstant]:
    """Return evenly spaced instants of the episodes, and hard scenes derived from the first; by name."""
    if not observed:
        return {}
    sampled = {
        f"instant {k}, {instant.scene.time_s:.1f} s into an episode": instant
        for k, instant in enumerate(evenly_spaced(observed), 1)
    }
    first = observed[0]
    hard_scenes = hard_scenes_of_traffic(first.scene)
    return sampled | {
        name: PlanningInstant(scene, _fitting(first, scene)) for name, scene in hard_scenes.items()
    }


def _fitting(first: PlanningInstant, changed: Scene) -> Tracks | None:
    """Return the log without the road users that *changed* has moved."""
    if first.log is None:
        return None
    original, altered = first.scene.history, changed.history
    common_ids = [name for name in original.ids if name in altered.index]
    moved = {
        name
        for name in common_ids
        if not np.array_equal(original.xy_m[original.index[name], -1], altered.xy_m[altered.index[name], -1])
    }
    return first.log.rows(np.array([name not in moved for name in first.log.ids], dtype=np.bool_))


def _contract(
    policy: TrafficPolicy, road: RoadMap, instants: Mapping[str, PlanningInstant]
) -> list[CheckResult]:
    problems = [
        (where, problem)
        for where, instant in instants.items()
        for problem in policy_problems(
            policy, road, instant.scene.copied(), instant.log and instant.log.copied()
        )
    ]
    scenes_and_logs = [(instant.scene, instant.log) for instant in instants.values()]
    remembers = bool(scenes_and_logs) and plans_from_memory_of_others(policy, road, scenes_and_logs)
    return contract_results(PolicyPart, problems, instants, remembers)


def _in_traffic(records: Sequence[EpisodeRecord], run: Run) -> CheckResult:
    """Return counts of problems that the contract does not forbid, for information only."""
    faults = [fault for record in records for fault in implausibilities(record, run.road)]
    collisions = sum(fault.what in ("collision", "drove through") for fault in faults)
    departures = sum(fault.what == "off the road" for fault in faults)
    refused = sum(
        record.failure is not None and record.failure.kind == PlanRefusedError.kind for record in records
    )
    moved = sum(int((record.controller == Controller.POLICY).any(axis=1).sum()) for record in records)
    changed_plans, checked_plans = np.sum([record.safeguarded for record in records], axis=0).tolist()
    counts = [
        f"{counted(moved, 'vehicle')} moved",
        counted(refused, "refused plan"),
        f"safeguard changed {changed_plans} of {counted(checked_plans, 'plan')}"
        if checked_plans
        else "no safeguard",
        f"{counted(collisions, 'collision')} of background vehicles",
        counted(departures, "road departure"),
    ]
    is_clean = not (collisions or departures) and all(record.failure is None for record in records)
    remedy = f"; advdiff-sumo run --background {run.names[1]} --check names each"
    remedy = remedy if collisions or departures else ""
    return CheckResult(IN_TRAFFIC, True if is_clean else None, ", ".join(counts) + remedy)


def _in_time(policy: TrafficPolicy, traffic: DrivenTraffic, within_ms: float) -> CheckResult:
    if plans_nothing(policy):
        return CheckResult(IN_TIME, True, "it plans nothing: SUMO drives everybody")
    return in_time(traffic.plans_s, within_ms)
