"""The interface of background policies, which move the background vehicles."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap


@runtime_checkable
class TrafficPolicy(Protocol):
    """A policy keeps no state between calls: it is given its memory and random numbers, and returns the memory."""

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        """Return the memory for a new episode.

        Args:
            road: the map.
            scene: the first instant.
            log: tracks of the vehicles in reality or in natural traffic, on the episode's clock, at any
                spacing; None if there is no log.
            rng: random numbers for this policy alone.
        """
        ...

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        """Return futures of the vehicles that it moves, at least one replanning period long, and its new memory.

        SUMO drives all other vehicles.
        """
        ...


@runtime_checkable
class UnboundedPolicy(TrafficPolicy, Protocol):
    """A policy that also moves vehicles beyond the control radius if ``everywhere`` is True, as ``replay`` does.

    Its episodes end with the log.
    """

    everywhere: ClassVar[bool]


def moves_everywhere(policy: TrafficPolicy) -> bool:
    """Return whether *policy* also moves vehicles beyond the control radius."""
    return isinstance(policy, UnboundedPolicy) and policy.everywhere
