"""What a tested planner is: something that SUMO drives, or a Python object that plans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from advdiff_sumo.core.plan import Plan
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap

LEFT_OFFSET_M = "leftOffset"
"""Key of :attr:`SumoDriver.params`: how far to the left of its lane's middle the vehicle drives (m).

SUMO's own ``latAlignment`` counts to the right where traffic keeps left; the episode writes it, as it knows the net.
"""


@runtime_checkable
class Planner(Protocol):
    """A planner keeps nothing between calls: its memory and random numbers come in and go out.

    A class registered as a target is called with keyword options (``Class(**options)``) and must then have
    these methods. ``memory`` is whatever the planner likes; it is passed back unchanged.
    """

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> Any:
        """Return the memory for a new episode that begins in *scene*."""
        ...

    def plan(self, road: RoadMap, scene: Scene, memory: Any, rng: np.random.Generator) -> tuple[Plan, Any]:
        """Return the plan for the target from now on, at least ``scene.least_plan_s`` long, and the new memory."""
        ...


@runtime_checkable
class Served(Protocol):
    """What a planner may have beside the two methods where something outside this process stands behind it."""

    def check(self) -> None:
        """Look whether it can be used, before anything is run; raises InputError where not."""
        ...

    def end(self, memory: Any, end: str, time_s: float, failure: str) -> None:
        """Take note that an episode is over: how it ended, when, and why where it failed."""
        ...

    def close(self) -> None:
        """Let go of what it holds; a later ``start`` gets it anew."""
        ...


class ServedPlanner(Planner, Served, Protocol):
    """A planner that something outside this process stands behind."""


@dataclass(frozen=True)
class SumoDriver:
    """A target that SUMO's own models drive; our code only looks.

    Attributes:
        car_following: SUMO's name, such as "IDM".
        lane_change: SUMO's name, such as "SL2015".
        params: further vType attributes, such as {"tau": 1.0}, and :data:`LEFT_OFFSET_M`.
    """

    car_following: str
    lane_change: str = "SL2015"
    params: Mapping[str, float | str] = field(default_factory=dict)


Target: TypeAlias = Planner | SumoDriver
