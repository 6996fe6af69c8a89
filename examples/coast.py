"""A simple background policy as a starting point: every movable vehicle keeps its speed and heading.

Run it::

    advdiff-sumo run --target IDM --background examples.coast:Coast
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap

STEP_S = 0.1


class Coast:
    """A policy in which every background vehicle keeps its speed and heading.

    Args:
        seconds: duration of a plan.
    """

    def __init__(self, seconds: float = 1.0) -> None:
        self.steps = round(seconds / STEP_S)

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> None:
        """Return the memory of a new episode: None, since none is needed."""
        del road, scene, log, rng

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[JointPlan, None]:
        """Return the future states of all movable vehicles, every 0.1 s from now + 0.1 s on."""
        del road, rng
        now = scene.history.rows(scene.movable).window(scene.history.steps - 1, scene.history.steps)
        ahead_s = STEP_S * np.arange(1, self.steps + 1)
        direction = np.stack((np.cos(now.yaw_rad), np.sin(now.yaw_rad)), axis=-1)
        ones = np.ones((now.agents, self.steps))
        tracks = replace(
            now,
            xy_m=now.xy_m + (now.speed_mps * ahead_s)[..., None] * direction,
            yaw_rad=now.yaw_rad * ones,
            speed_mps=now.speed_mps * ones,
            valid=now.valid & (ones > 0),
            t0_s=scene.time_s + STEP_S,
            dt_s=STEP_S,
        )
        return JointPlan(tracks), memory
