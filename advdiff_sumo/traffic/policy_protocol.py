"""What moves the background vehicles."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap


@runtime_checkable
class TrafficPolicy(Protocol):
    """A policy keeps nothing between calls: its memory and random numbers come in and go out."""

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Any:
        """Return the memory for a new episode.

        Args:
            road: the map.
            scene: the first instant.
            log: what the vehicles did in reality or in natural traffic, on the episode's clock, at any
                spacing; None when there is no log.
            rng: the policy's own random numbers.
        """
        ...

    def plan(
        self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator
    ) -> tuple[JointPlan, Any]:
        """Return futures of the vehicles it moves, at least one replanning period long.

        SUMO drives the rest.
        """
        ...


@runtime_checkable
class UnboundedPolicy(TrafficPolicy, Protocol):
    """A policy that, where ``everywhere`` is True, moves vehicles beyond the control radius too, as ``replay`` does.

    Its episodes end with the log.
    """

    everywhere: ClassVar[bool]


def moves_everywhere(policy: TrafficPolicy) -> bool:
    """Return whether the control radius does not bind *policy*."""
    return isinstance(policy, UnboundedPolicy) and policy.everywhere
