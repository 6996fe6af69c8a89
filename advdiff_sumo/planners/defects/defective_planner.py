"""A planner with planted faults: what it is given and what it returns pass through them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.plan_form import can_be_driven, in_float64
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects.planted_fault import PlantedFault
from advdiff_sumo.planners.planner_protocol import Planner, Served, ServedPlanner

_SEED_BITS = 62


@dataclass(frozen=True)
class _Memory:
    """What a defective planner remembers.

    Attributes:
        planner: the sound planner's own memory.
        seeds: of each fault.
        perceived: each fault's memory of what was given.
        acted: each fault's memory of what was returned.
    """

    planner: Any
    seeds: tuple[SeedTree, ...]
    perceived: tuple[Any, ...]
    acted: tuple[Any, ...]


@dataclass(frozen=True)
class DefectivePlanner:
    """Any planner, ours or a user's, with faults between it and the world.

    What the planner is given passes through the faults in their order, what it returns in the opposite one. Faults
    draw from a child of the target's generator, so that the planner draws the same numbers as without them.

    Attributes:
        planner: the sound one.
        faults: what is planted.
    """

    planner: Planner
    faults: tuple[PlantedFault, ...]

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> _Memory:
        """Return the memory of an episode that begins in *scene*."""
        root = SeedTree(int(rng.spawn(1)[0].integers(1 << _SEED_BITS)))
        seeds = tuple(root.child(type(fault).__name__) for fault in self.faults)
        nothing = (None,) * len(self.faults)
        scenes, _ = self._perceive(road, scene, seeds, nothing)
        return _Memory(self.planner.start(road, scenes[-1].copied(), rng), seeds, nothing, nothing)

    def plan(
        self, road: RoadMap, scene: Scene, memory: _Memory, rng: np.random.Generator
    ) -> tuple[Plan, _Memory]:
        """Return what is driven, and the new memory."""
        scenes, perceived = self._perceive(road, scene, memory.seeds, memory.perceived)
        memory = replace(memory, perceived=perceived)
        for k, (fault, acted) in enumerate(zip(self.faults, memory.acted, strict=True)):
            held = fault.held_plan(scene, acted)
            if held is not None:
                return self._acted_on(held, scenes, memory, k)
        planned: Any = self.planner.plan(road, scenes[-1].copied(), memory.planner, rng)
        if not (isinstance(planned, tuple) and len(planned) == 2):
            return planned  # type: ignore[no-any-return] # no plan: the episode refuses it and says so
        plan, own = planned
        if not can_be_driven(plan, scene.least_plan_s):
            return plan, replace(
                memory, planner=own
            )  # the episode refuses it, in the words that it has without faults
        return self._acted_on(in_float64(plan), scenes, replace(memory, planner=own), len(self.faults))

    def _acted_on(
        self, plan: Plan, scenes: Sequence[Scene], memory: _Memory, count: int
    ) -> tuple[Plan, _Memory]:
        """Return what the first *count* faults, the last of them first, make of *plan*, and their memories."""
        acted = list(memory.acted)
        for k in reversed(range(count)):
            plan, acted[k] = self.faults[k].act(plan, scenes[k], memory.acted[k])
        return plan, replace(memory, acted=tuple(acted))

    def _perceive(
        self, road: RoadMap, scene: Scene, seeds: tuple[SeedTree, ...], memories: tuple[Any, ...]
    ) -> tuple[list[Scene], tuple[Any, ...]]:
        """Return what each fault is given, what the planner is given last, and the faults' new memories."""
        scenes, after = [scene], []
        for fault, seed, memory in zip(self.faults, seeds, memories, strict=True):
            given, kept = fault.perceive(road, scenes[-1], memory, seed)
            scenes.append(given)
            after.append(kept)
        return scenes, tuple(after)


class ServedDefectivePlanner(DefectivePlanner):
    """The same around a planner that something outside this process stands behind."""

    planner: ServedPlanner

    def check(self) -> None:
        """Look whether the planner can be used; raises InputError where not."""
        self.planner.check()

    def end(self, memory: _Memory, end: str, time_s: float, failure: str) -> None:
        """Tell the planner that an episode is over."""
        self.planner.end(memory.planner, end, time_s, failure)

    def close(self) -> None:
        """Let the planner let go of what it holds."""
        self.planner.close()


def with_faults(planner: Planner, faults: tuple[PlantedFault, ...]) -> Planner:
    """Return *planner* with *faults*."""
    if isinstance(planner, Served):
        return ServedDefectivePlanner(planner, faults)
    return DefectivePlanner(planner, faults)
