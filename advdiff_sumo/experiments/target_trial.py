"""Checks a planner: its contract in scenes of real traffic and in hard scenes, and its driving in SUMO."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.experiments.check_results import (
    CheckResult,
    checked_in_worker,
    contract_results,
    drives_results,
    evenly_spaced,
    in_time,
)
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.planners.hard_scenes import hard_scenes
from advdiff_sumo.planners.planner_check import Part, carries_over, problems_of
from advdiff_sumo.planners.planner_protocol import Planner, Served, ServedPlanner, SumoDriver
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.run_episodes import RunOptions, check_together, target_of
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from advdiff_sumo.sim.warmup_scenes import NaturalTraffic
from advdiff_sumo.sweep.tasks import WorkerLimits
from advdiff_sumo.traffic.sumo_traffic import SumoTraffic


@dataclass(frozen=True)
class Extent:
    """The extent of a check.

    Attributes:
        net: path of a net, or name of a shipped one.
        episodes: number of episodes in SUMO.
        horizon_s: duration of an episode.
        within_ms: longest permitted median time of a plan.
        seed: of traffic and planner.
    """

    net: str = "downtown"
    episodes: int = 2
    horizon_s: float = 10.0
    within_ms: float = 500.0
    seed: int = 0


@dataclass
class WatchedPlanner:
    """Wraps a planner and stores its scenes, also one in which it raises an error as an episode starts."""

    planner: Planner
    scenes: list[Scene] = field(default_factory=list)
    starts: list[Scene] = field(default_factory=list)

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> Any:
        """Store the scene at the episode's start, and pass the call on."""
        self.starts.append(scene.copied())
        return self.planner.start(road, scene, rng)

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Store the scene, and pass the call on."""
        self.scenes.append(scene.copied())
        return self.planner.plan(road, scene, memory, rng)


@dataclass
class WatchedServedPlanner(WatchedPlanner):
    """The same for a planner that runs outside this process and is notified at the end of an episode."""

    planner: ServedPlanner

    def check(self) -> None:
        """Pass the call on."""
        self.planner.check()

    def end(self, memory: Any, end: str, time_s: float, failure: str) -> None:
        """Pass the call on."""
        self.planner.end(memory, end, time_s, failure)

    def close(self) -> None:
        """Pass the call on."""
        self.planner.close()


@dataclass(frozen=True)
class TrialResults:
    """The results of the episodes.

    Attributes:
        records: of the episodes.
        again: record of the first episode, run a second time.
        plans_s: wall-clock seconds of each plan.
        scenes: in which the planner planned; if it never did, the starts of the episodes.
    """

    records: tuple[EpisodeRecord, ...]
    again: EpisodeRecord
    plans_s: FloatArray
    scenes: tuple[Scene, ...]


def check_in_worker(
    name: str,
    options: Mapping[str, Any],
    extent: Extent,
    limits: WorkerLimits,
    on_output: Callable[[str], None],
) -> list[CheckResult]:
    """Run :func:`check_target` in a process of its own and return its results.

    If the planner ends the process or does not return in time, the only result says so.

    Args:
        name: as for ``--target``.
        options: of the planner.
        extent: of the check.
        limits: of the worker.
        on_output: called with what the planner printed.

    Raises:
        InputError: there is no such planner, or it cannot be made.
    """
    return checked_in_worker(partial(check_target, name, dict(options), extent), limits, on_output)


def check_target(name: str, options: Mapping[str, Any], extent: Extent) -> list[CheckResult]:
    """Check the planner *name*.

    Args:
        name: as for ``--target``.
        options: of the planner.
        extent: of the check.

    Raises:
        InputError: there is no such planner, or it cannot be made.
        ConfigError: it is one of SUMO's driver models.
    """
    run_options = RunOptions.parse({"target": name, "target_options": dict(options)})
    planner = target_of(run_options)
    if isinstance(planner, SumoDriver):
        raise ConfigError(f"target '{name}' is driven by SUMO itself: there is no planner to check")
    check_together(run_options, planner)
    road = RoadMap.read(find_net(extent.net))
    result = drive(planner, name, road, extent)
    scenes = _scenes(result.scenes)
    problems = [
        (where, problem) for where, scene in scenes.items() for problem in problems_of(planner, road, scene)
    ]
    contract = contract_results(Part, problems, scenes, carries_over(planner, road, list(scenes.values())))
    drives = drives_results(result.records, result.again)
    return [*contract, *drives, in_time(result.plans_s, extent.within_ms)]


def drive(planner: Planner, name: str, road: RoadMap, extent: Extent) -> TrialResults:
    """Run *planner* in SUMO's traffic; the first episode is run twice."""
    source = NaturalTraffic(
        road,
        None,
        SceneOptions(scenes_per_warmup=extent.episodes),
        SimOptions(),
        extent.horizon_s,
        SeedTree(extent.seed),
    )
    seed_scenes = source.batch(0)[: extent.episodes]
    watched = WatchedServedPlanner(planner) if isinstance(planner, Served) else WatchedPlanner(planner)
    episodes = [_episode(k, start, road, watched, name, extent) for k, start in enumerate(seed_scenes)]
    repeated, _ = _episode(0, seed_scenes[0], road, planner, name, extent)
    plans_s = np.array([plan_s for _, plans in episodes for plan_s in plans])
    return TrialResults(
        tuple(record for record, _ in episodes), repeated, plans_s, tuple(watched.scenes or watched.starts)
    )


def _episode(
    number: int, start: SeedScene, road: RoadMap, planner: Planner, name: str, extent: Extent
) -> tuple[EpisodeRecord, tuple[float, ...]]:
    sim = SimOptions(record_natural=False, record_plans=0)
    seed = SeedTree(extent.seed).child("episode", number)
    names = (name, "sumo")
    episode = Episode(number, start, road, planner, SumoTraffic(), names, sim, extent.horizon_s, seed)
    record, timing = episode.run()
    return record, timing.target_plans_s


def _scenes(scenes: Sequence[Scene]) -> dict[str, Scene]:
    """Return evenly spaced scenes of the episodes, and hard scenes derived from the first; by name."""
    if not scenes:
        return {}
    sampled = {f"at {scene.time_s:.1f} s of a drive": scene for scene in evenly_spaced(scenes)}
    return sampled | hard_scenes(scenes[0])
