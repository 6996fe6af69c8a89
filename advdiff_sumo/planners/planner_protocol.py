"""Define what a target is: a vehicle that SUMO's models drive, or a Python object that plans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap

LEFT_OFFSET_M = "leftOffset"
"""Key of :attr:`SumoDriver.params`: lateral offset from the middle of the lane (m), left positive.

The episode translates it into SUMO's ``latAlignment``, which is right positive on nets where traffic keeps left.
"""


@runtime_checkable
class Planner(Protocol):
    """A planner keeps no state between calls: its memory and random numbers are passed in and returned.

    A class registered as a target is called with keyword options (``Class(**options)``) and must then have
    these methods. ``memory`` may be any object; it is passed back unchanged.
    """

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> Any:
        """Return the memory for a new episode that begins in *scene*."""
        ...

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Return the plan for the target, at least ``scene.least_plan_s`` long, and the new memory."""
        ...


@runtime_checkable
class Served(Protocol):
    """Optional further methods of a planner that uses a resource outside this process, such as a server."""

    def check(self) -> None:
        """Check that the planner can be used, before anything is run; raise an InputError if not."""
        ...

    def end(self, memory: Any, end: str, time_s: float, failure: str) -> None:
        """Receive the outcome of an episode: how it ended, when, and the reason if it failed."""
        ...

    def close(self) -> None:
        """Release the resource; a later ``start`` acquires it again."""
        ...


class ServedPlanner(Planner, Served, Protocol):
    """A planner that uses a resource outside this process."""


@dataclass(frozen=True)
class SumoDriver:
    """A target that SUMO's own models drive.

    Attributes:
        car_following: SUMO's name of the car-following model, such as "IDM".
        lane_change: SUMO's name of the lane-change model, such as "SL2015".
        params: further vType attributes, such as {"tau": 1.0}, and :data:`LEFT_OFFSET_M`.
    """

    car_following: str
    lane_change: str = "SL2015"
    params: Mapping[str, float | str] = field(default_factory=dict)


Target: TypeAlias = Planner | SumoDriver
