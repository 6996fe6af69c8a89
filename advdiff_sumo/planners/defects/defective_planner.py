"""Plant faults in a planner: the scenes that it gets and the plans that it returns pass through them."""

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
from advdiff_sumo.planners.defects.planted_defect import PlantedDefect
from advdiff_sumo.planners.planner_protocol import Planner, Served, ServedPlanner

_SEED_BITS = 62


@dataclass(frozen=True)
class _Memory:
    """Memory of a defective planner.

    Attributes:
        planner: memory of the sound planner.
        seeds: seed of each fault.
        perceived: memory of each fault for scenes.
        acted: memory of each fault for plans.
    """

    planner: Any
    seeds: tuple[SeedTree, ...]
    perceived: tuple[Any, ...]
    acted: tuple[Any, ...]


@dataclass(frozen=True)
class DefectivePlanner:
    """Any planner, built-in or a user's, with planted faults.

    The scene passes through the faults in their order, the plan in the opposite order. The faults draw from a child
    of the target's generator, so that the planner draws the same numbers as without them.

    Attributes:
        planner: the sound planner.
        faults: the planted faults.
    """

    planner: Planner
    faults: tuple[PlantedDefect, ...]

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> _Memory:
        """Return the memory of an episode that begins in *scene*."""
        root = SeedTree(int(rng.spawn(1)[0].integers(1 << _SEED_BITS)))
        seeds = tuple(root.child(type(fault).__name__) for fault in self.faults)
        no_memory = (None,) * len(self.faults)
        scenes, _ = self._perceive(road, scene, seeds, no_memory)
        return _Memory(self.planner.start(road, scenes[-1].copied(), rng), seeds, no_memory, no_memory)

    def plan(
        self, road: RoadMap, scene: Scene, memory: _Memory, rng: np.random.Generator
    ) -> tuple[Plan, _Memory]:
        """Return the plan to drive, and the new memory."""
        scenes, perceived = self._perceive(road, scene, memory.seeds, memory.perceived)
        memory = replace(memory, perceived=perceived)
        for k, (fault, acted) in enumerate(zip(self.faults, memory.acted, strict=True)):
            held = fault.held_plan(scene, acted)
            if held is not None:
                return self._after_faults(held, scenes, memory, k)
        answer: Any = self.planner.plan(road, scenes[-1].copied(), memory.planner, rng)
        if not (isinstance(answer, tuple) and len(answer) == 2):
            return answer  # type: ignore[no-any-return] # no plan; the episode refuses it
        plan, planner_memory = answer
        if not can_be_driven(plan, scene.least_plan_s):
            # the episode refuses the plan, with the same message as without faults
            return plan, replace(memory, planner=planner_memory)
        return self._after_faults(
            in_float64(plan), scenes, replace(memory, planner=planner_memory), len(self.faults)
        )

    def _after_faults(
        self, plan: Plan, scenes: Sequence[Scene], memory: _Memory, count: int
    ) -> tuple[Plan, _Memory]:
        """Return *plan* after the first *count* faults, in reverse order, and the new memory."""
        acted = list(memory.acted)
        for k in reversed(range(count)):
            plan, acted[k] = self.faults[k].act(plan, scenes[k], memory.acted[k])
        return plan, replace(memory, acted=tuple(acted))

    def _perceive(
        self, road: RoadMap, scene: Scene, seeds: tuple[SeedTree, ...], memories: tuple[Any, ...]
    ) -> tuple[list[Scene], tuple[Any, ...]]:
        """Return the scene before each fault and after the last one, and the faults' new memories."""
        scenes, new_memories = [scene], []
        for fault, seed, memory in zip(self.faults, seeds, memories, strict=True):
            perceived, new_memory = fault.perceive(road, scenes[-1], memory, seed)
            scenes.append(perceived)
            new_memories.append(new_memory)
        return scenes, tuple(new_memories)


class ServedDefectivePlanner(DefectivePlanner):
    """The same for a planner that uses a resource outside this process."""

    planner: ServedPlanner

    def check(self) -> None:
        """Check that the planner can be used; raise an InputError if not."""
        self.planner.check()

    def end(self, memory: _Memory, end: str, time_s: float, failure: str) -> None:
        """Tell the planner that an episode is over."""
        self.planner.end(memory.planner, end, time_s, failure)

    def close(self) -> None:
        """Let the planner release its resource."""
        self.planner.close()


def with_defects(planner: Planner, faults: tuple[PlantedDefect, ...]) -> Planner:
    """Return *planner* with *faults*."""
    if isinstance(planner, Served):
        return ServedDefectivePlanner(planner, faults)
    return DefectivePlanner(planner, faults)
