"""Drives an episode again with the careful driver in the target's place, while the others really react.

A verdict lets the others move as recorded. Here the same episode is run again, from the same state with the same
seed, the target's own planner drives up to the takeover, and the others answer to what the careful driver does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plan import Plan, Trajectory
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import Collision, collisions, target_collision
from advdiff_sumo.metrics.reference import ReferenceDrive
from advdiff_sumo.metrics.verdict import YARDSTICK, judge
from advdiff_sumo.planners.planner_protocol import Planner, Served, ServedPlanner
from advdiff_sumo.planners.reference import CarefulPlanner
from advdiff_sumo.sim.episode import Episode

_SAME_PLACE_M = 1e-6
_PLANNED_STEPS = 20


class Driver(StrEnum):
    """Who drives from the takeover on."""

    CAREFUL = "careful"
    """The target ``careful``, which sees what the others do now, and drives as the lane-graph planner otherwise."""
    SAME = "same"
    """The verdict's reference drive, as it is: all that differs is that the others react."""


@dataclass(frozen=True)
class HandoverMemory:
    """Memory of :class:`HandedOver`.

    Attributes:
        first: of the first planner.
        second: of the second one; None before it drives.
    """

    first: Any
    second: Any = None


class HandedOver:
    """A planner that another one takes over from at an instant; both keep the contract of planners.

    Args:
        first: drives at first.
        second: drives from *takeover_s* on, as if the episode began there.
        takeover_s: since the episode's start.
    """

    def __init__(self, first: Planner, second: Planner, takeover_s: float) -> None:
        self.first, self.second, self.takeover_s = first, second, takeover_s

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> HandoverMemory:
        """Return the memory of an episode that begins."""
        return HandoverMemory(self.first.start(road, scene, rng))

    def plan(
        self, road: RoadMap, scene: Scene, memory: HandoverMemory, rng: np.random.Generator
    ) -> tuple[Plan, HandoverMemory]:
        """Return the plan of whoever drives now."""
        if scene.time_s < self.takeover_s - 1e-6:
            plan, first = self.first.plan(road, scene, memory.first, rng)
            return plan, HandoverMemory(first)
        begun = memory.second if memory.second is not None else self.second.start(road, scene, rng)
        plan, second = self.second.plan(road, scene, begun, rng)
        return plan, HandoverMemory(memory.first, second)


class ServedHandedOver(HandedOver):
    """The same where something outside this process stands behind the first planner, which is told of the end."""

    first: ServedPlanner

    def check(self) -> None:
        """Look whether the first planner can be used; raises InputError where not."""
        self.first.check()

    def end(self, memory: HandoverMemory, end: str, time_s: float, failure: str) -> None:
        """Tell the first planner that the episode is over."""
        self.first.end(memory.first, end, time_s, failure)

    def close(self) -> None:
        """Let the first planner let go of what it holds."""
        self.first.close()


def handed_over(first: Planner, second: Planner, takeover_s: float) -> HandedOver:
    """Return *first*, which *second* takes over from at *takeover_s*."""
    kind = ServedHandedOver if isinstance(first, Served) else HandedOver
    return kind(first, second, takeover_s)


class SameDrive:
    """Drives a recorded path on, and then a reference drive, whatever the others do.

    Args:
        record: whose target drives up to the takeover.
        drive: from there on.
    """

    def __init__(self, record: EpisodeRecord, drive: ReferenceDrive) -> None:
        tracks, row, until = record.tracks, record.target, drive.takeover_step
        self.xy_m = np.concatenate((tracks.xy_m[row, :until], drive.states.xy_m))
        self.yaw_rad = np.concatenate((tracks.yaw_rad[row, :until], drive.states.yaw_rad))
        self.speed_mps = np.concatenate((tracks.speed_mps[row, :until], drive.states.speed_mps))
        self.dt_s = tracks.dt_s

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Nothing to remember."""

    def plan(
        self,
        road: RoadMap,  # noqa: ARG002 - the contract's
        scene: Scene,
        memory: None,  # noqa: ARG002 - the contract's
        rng: np.random.Generator,  # noqa: ARG002 - the contract's
    ) -> tuple[Plan, None]:
        """Return the next 2 s; at the end it stays where it is."""
        ahead = round(scene.time_s / self.dt_s) + 1 + np.arange(_PLANNED_STEPS)
        at = np.minimum(ahead, len(self.xy_m) - 1)
        return Trajectory(self.xy_m[at], self.yaw_rad[at], self.speed_mps[at], self.dt_s), None


@dataclass(frozen=True)
class ClosedLoop:
    """What the careful driver comes to against the same collision, twice.

    Attributes:
        preventable: it avoids the collision while the others move as recorded: the verdict.
        avoided: it does while they react.
        takeover_s: when it takes over in the episode that was run again: at the target's plan before that of the
            verdict.
        run_into: in that episode a third ran into its rear, which is not held against it, as in the verdict.
    """

    preventable: bool
    avoided: bool
    takeover_s: float
    run_into: bool


def close_loop(episode: Episode, record: EpisodeRecord, driver: Driver = Driver.CAREFUL) -> ClosedLoop | None:
    """Run *episode*, which came to *record*, with a careful *driver* from the takeover of its verdict on.

    It lasts as long as the reference drive of the verdict: until that stands, or 3 s beyond the record. None where the
    target did not collide with anybody, or the verdict has no reference drive.

    Raises:
        ConfigError: the target is no Python planner, or the episode does not repeat.
        InputError: it cannot be run.
    """
    struck = target_collision(record, collisions(record))
    if struck is None:
        return None
    verdict = judge(record, episode.road, struck)
    if verdict.preventable is None:
        return None
    if not isinstance(episode.target, Planner):
        raise ConfigError(f"target '{episode.names[0]}' is driven by SUMO, from whom nobody can take over")
    drive, dt_s = verdict.drives[YARDSTICK], record.tracks.dt_s
    period = episode.sim.substeps * episode.sim.replan_every
    takeover = drive.takeover_step // period * period
    last = drive.takeover_step + len(drive.states.speed_mps) - 1
    careful = CarefulPlanner() if driver is Driver.CAREFUL else SameDrive(record, drive)
    target = handed_over(episode.target, careful, takeover * dt_s)
    again, _ = replace(episode, target=target, horizon_s=last * dt_s).run()
    if again.failure is not None:
        raise ConfigError(f"the episode failed when run again: {again.failure.message}")
    _must_repeat(record, again, takeover)
    hit = target_collision(again, collisions(again))
    run_into = hit is not None and _run_into(again, hit, record.tracks.ids[struck.rows[1]])
    return ClosedLoop(verdict.preventable, hit is None or run_into, takeover * dt_s, run_into)


def _must_repeat(record: EpisodeRecord, again: EpisodeRecord, until: int) -> None:
    before, after = (x.tracks.xy_m[x.target, : until + 1] for x in (record, again))
    if before.shape != after.shape or not np.allclose(before, after, rtol=0.0, atol=_SAME_PLACE_M):
        raise ConfigError("the episode does not repeat: another version, or a planner with a memory")


def _run_into(again: EpisodeRecord, hit: Collision, partner: str) -> bool:
    """Return whether a third came from behind."""
    return again.tracks.ids[hit.rows[1]] != partner and hit.faces[0] == "rear"
