"""Repeat an episode with the careful driver in the target's place, while the others react.

For a verdict, the others move as recorded. Here, the same episode is run again with the same seed. The target's own
planner drives up to the takeover, then the careful driver, and the others react to it.
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

_POSITION_TOLERANCE_M = 1e-6
_PLANNED_STEPS = 20


class Driver(StrEnum):
    """Drivers that can take over."""

    CAREFUL = "careful"
    """The target ``careful``, which responds to what the others do now, and otherwise drives as ``lane_graph``."""
    SAME = "same"
    """The unchanged reference drive of the verdict, so that the only difference is that the others react."""


@dataclass(frozen=True)
class HandoverMemory:
    """Memory of :class:`HandedOver`.

    Attributes:
        first: memory of the first planner.
        second: memory of the second planner; None before it drives.
    """

    first: Any
    second: Any = None


class HandedOver:
    """A planner that consists of two planners, of which the second one takes over.

    Args:
        first: drives before the takeover.
        second: drives from *takeover_s* on, as if the episode began there.
        takeover_s: time since the start of the episode.
    """

    def __init__(self, first: Planner, second: Planner, takeover_s: float) -> None:
        self.first, self.second, self.takeover_s = first, second, takeover_s

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> HandoverMemory:
        """Return the memory of a new episode."""
        return HandoverMemory(self.first.start(road, scene, rng))

    def plan(
        self, road: RoadMap, scene: Scene, memory: HandoverMemory, rng: np.random.Generator
    ) -> tuple[Plan, HandoverMemory]:
        """Return the plan of the planner that drives now."""
        if scene.time_s < self.takeover_s - 1e-6:
            plan, first = self.first.plan(road, scene, memory.first, rng)
            return plan, HandoverMemory(first)
        before = memory.second if memory.second is not None else self.second.start(road, scene, rng)
        plan, second = self.second.plan(road, scene, before, rng)
        return plan, HandoverMemory(memory.first, second)


class ServedHandedOver(HandedOver):
    """A :class:`HandedOver` whose first planner runs outside this process and is informed of the episode's end."""

    first: ServedPlanner

    def check(self) -> None:
        """Check that the first planner can be used; raise InputError if not."""
        self.first.check()

    def end(self, memory: HandoverMemory, end: str, time_s: float, failure: str) -> None:
        """Inform the first planner that the episode has ended."""
        self.first.end(memory.first, end, time_s, failure)

    def close(self) -> None:
        """Release the resources of the first planner."""
        self.first.close()


def handed_over(first: Planner, second: Planner, takeover_s: float) -> HandedOver:
    """Return a planner that drives by *first*, and from *takeover_s* on by *second*."""
    kind = ServedHandedOver if isinstance(first, Served) else HandedOver
    return kind(first, second, takeover_s)


class SameDrive:
    """A planner that follows a recorded path and then a reference drive, independently of the others.

    Args:
        record: its target is followed up to the takeover.
        drive: followed from the takeover on.
    """

    def __init__(self, record: EpisodeRecord, drive: ReferenceDrive) -> None:
        tracks, row, until = record.tracks, record.target, drive.takeover_step
        self.xy_m = np.concatenate((tracks.xy_m[row, :until], drive.states.xy_m))
        self.yaw_rad = np.concatenate((tracks.yaw_rad[row, :until], drive.states.yaw_rad))
        self.speed_mps = np.concatenate((tracks.speed_mps[row, :until], drive.states.speed_mps))
        self.dt_s = tracks.dt_s

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Return None, since there is nothing to remember."""

    def plan(
        self,
        road: RoadMap,  # noqa: ARG002 - required by the contract
        scene: Scene,
        memory: None,  # noqa: ARG002 - required by the contract
        rng: np.random.Generator,  # noqa: ARG002 - required by the contract
    ) -> tuple[Plan, None]:
        """Return the next 2 s; after its end the last state is repeated."""
        steps = round(scene.time_s / self.dt_s) + 1 + np.arange(_PLANNED_STEPS)
        steps = np.minimum(steps, len(self.xy_m) - 1)
        return Trajectory(self.xy_m[steps], self.yaw_rad[steps], self.speed_mps[steps], self.dt_s), None


@dataclass(frozen=True)
class ClosedLoop:
    """Whether the careful driver avoids a collision, with recorded and with reacting others.

    Attributes:
        preventable: whether it avoids the collision while the others move as recorded; this is the verdict.
        avoided: whether it avoids the collision while the others react.
        takeover_s: time of the takeover in the repeated episode: that of the last plan up to the verdict's takeover.
        run_into: whether a third vehicle ran into its rear in the repeated episode; as in the verdict, this does not
            count as a collision of the careful driver.
    """

    preventable: bool
    avoided: bool
    takeover_s: float
    run_into: bool


def close_loop(episode: Episode, record: EpisodeRecord, driver: Driver = Driver.CAREFUL) -> ClosedLoop | None:
    """Repeat *episode*, whose record is *record*, with a careful *driver* from the takeover of its verdict on.

    The repetition is as long as the reference drive of the verdict. Return None if the target did not collide, or if
    the verdict has no reference drive.

    Raises:
        ConfigError: the target is not a Python planner, or the repetition differs from the record before the takeover.
        InputError: the episode cannot be run.
    """
    collision = target_collision(record, collisions(record))
    if collision is None:
        return None
    verdict = judge(record, episode.road, collision)
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
    repetition, _ = replace(episode, target=target, horizon_s=last * dt_s).run()
    if repetition.failure is not None:
        raise ConfigError(f"the episode failed when run again: {repetition.failure.message}")
    _must_repeat(record, repetition, takeover)
    hit = target_collision(repetition, collisions(repetition))
    run_into = hit is not None and _run_into(repetition, hit, record.tracks.ids[collision.rows[1]])
    return ClosedLoop(verdict.preventable, hit is None or run_into, takeover * dt_s, run_into)


def _must_repeat(record: EpisodeRecord, again: EpisodeRecord, until: int) -> None:
    """Raise ConfigError unless the target's path is the same up to the step *until*."""
    before, after = (x.tracks.xy_m[x.target, : until + 1] for x in (record, again))
    if before.shape != after.shape or not np.allclose(before, after, rtol=0.0, atol=_POSITION_TOLERANCE_M):
        raise ConfigError("the episode does not repeat: another version, or a planner with a memory")


def _run_into(repetition: EpisodeRecord, hit: Collision, partner: str) -> bool:
    """Return whether a vehicle other than *partner* ran into the target's rear."""
    return repetition.tracks.ids[hit.rows[1]] != partner and hit.faces[0] == "rear"
