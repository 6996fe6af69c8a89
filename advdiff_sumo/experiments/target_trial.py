"""Whether a planner may be tested: its contract in scenes of real traffic and in hard ones, and its driving in SUMO."""

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
    """How much is tried.

    Attributes:
        net: a net's path, or a shipped one's name.
        episodes: drives in SUMO.
        horizon_s: length of a drive.
        within_ms: longest median time of a plan.
        seed: of traffic and planner.
    """

    net: str = "downtown"
    episodes: int = 2
    horizon_s: float = 10.0
    within_ms: float = 500.0
    seed: int = 0


@dataclass
class WatchedPlanner:
    """A planner whose scenes are kept, also that in which it raises as an episode starts."""

    planner: Planner
    scenes: list[Scene] = field(default_factory=list)
    starts: list[Scene] = field(default_factory=list)

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> Any:
        """Keep the scene where nothing is planned in it, and pass the call on."""
        self.starts.append(scene.copied())
        return self.planner.start(road, scene, rng)

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Keep the scene, and pass the call on."""
        self.scenes.append(scene.copied())
        return self.planner.plan(road, scene, memory, rng)


@dataclass
class WatchedServedPlanner(WatchedPlanner):
    """The same of one that something outside this process stands behind, which is told when an episode is over."""

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
class Driven:
    """What the drives came to."""

    records: tuple[EpisodeRecord, ...]
    again: EpisodeRecord
    plans_s: FloatArray
    scenes: tuple[Scene, ...]


def check_in_worker(
    name: str, options: Mapping[str, Any], extent: Extent, limits: WorkerLimits, hear: Callable[[str], None]
) -> list[CheckResult]:
    """Return what :func:`check_target` returns, or one verdict on a planner that ends the process or never comes back.

    Args:
        name: as of ``--target``.
        options: of the planner.
        extent: how much is tried.
        limits: of the worker.
        hear: called with what the planner printed.

    Raises:
        InputError: there is no such planner, or it cannot be made.
    """
    return checked_in_worker(partial(check_target, name, dict(options), extent), limits, hear)


def check_target(name: str, options: Mapping[str, Any], extent: Extent) -> list[CheckResult]:
    """Return the verdicts on the planner *name*.

    Args:
        name: as of ``--target``.
        options: of the planner.
        extent: how much is tried.

    Raises:
        InputError: there is no such planner, or it cannot be made.
        ConfigError: it is one of SUMO's driver models.
    """
    asked = RunOptions.parse({"target": name, "target_options": dict(options)})
    planner = target_of(asked)
    if isinstance(planner, SumoDriver):
        raise ConfigError(f"target '{name}' is driven by SUMO itself: there is no planner to check")
    check_together(asked, planner)
    road = RoadMap.read(find_net(extent.net))
    driven = drive(planner, name, road, extent)
    scenes = _scenes(driven.scenes)
    problems = [(where, x) for where, scene in scenes.items() for x in problems_of(planner, road, scene)]
    contract = contract_results(Part, problems, scenes, carries_over(planner, road, list(scenes.values())))
    drives = drives_results(driven.records, driven.again)
    return [*contract, *drives, in_time(driven.plans_s, extent.within_ms)]


def drive(planner: Planner, name: str, road: RoadMap, extent: Extent) -> Driven:
    """Let *planner* drive in SUMO's traffic, the first scene twice."""
    source = NaturalTraffic(
        road,
        None,
        SceneOptions(scenes_per_warmup=extent.episodes),
        SimOptions(),
        extent.horizon_s,
        SeedTree(extent.seed),
    )
    starts = source.batch(0)[: extent.episodes]
    watched = WatchedServedPlanner(planner) if isinstance(planner, Served) else WatchedPlanner(planner)
    episodes = [_episode(k, start, road, watched, name, extent) for k, start in enumerate(starts)]
    again, _ = _episode(0, starts[0], road, planner, name, extent)
    times = np.array([t for _, plans in episodes for t in plans])
    return Driven(
        tuple(record for record, _ in episodes), again, times, tuple(watched.scenes or watched.starts)
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
    """Return scenes out of the drives, evenly taken, and hard ones made of the first."""
    if not scenes:
        return {}
    picked = {f"at {scene.time_s:.1f} s of a drive": scene for scene in evenly_spaced(scenes)}
    return picked | hard_scenes(scenes[0])
