"""Episodes and a policy that several test modules use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_protocol import Target
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.episode_loop import Loop
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.sim.session import Session
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sim.start import prepare
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from advdiff_sumo.traffic.policy_registry import make_policy


def episode(
    scene: SeedScene,
    road: RoadMap,
    target: str | Target = "IDM",
    background: str | TrafficPolicy = "sumo",
    horizon_s: float = 5.0,
    **sim: Any,
) -> Episode:
    """Return an episode that is ready to run."""
    return Episode(
        number=0,
        scene=scene,
        road=road,
        target=make_target(target, {}) if isinstance(target, str) else target,
        policy=make_policy(background, {}) if isinstance(background, str) else background,
        names=("target", "background"),
        sim=SimOptions.parse({"stop_at_collision": False, **sim}),
        horizon_s=horizon_s,
        seed=SeedTree(5),
    )


@contextmanager
def running(made: Episode, folder: Path) -> Iterator[Loop]:
    """Yield the started loop of an episode, so that a test can query SUMO in between."""
    preparation = prepare(made.scene, made.target, made.sim, folder)
    with Session(preparation.options) as session:
        loop = Loop(made, session, preparation.type_of_class)
        loop.start()
        yield loop


class StraightOn:
    """All movable vehicles keep speed and heading; a bicycle model can drive this."""

    def __init__(self, speed_mps: float | None = None, until_s: float = np.inf) -> None:
        self.speed_mps, self.until_s = speed_mps, until_s

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> None:
        """Return no memory."""

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[JointPlan, None]:
        """Return 2 s straight on."""
        now = scene.history.rows(scene.movable & (scene.time_s < self.until_s))
        times = 0.5 * np.arange(1, 5)
        speed = now.speed_mps[:, -1:] * np.ones(4)
        if self.speed_mps is not None:
            speed = np.full_like(speed, self.speed_mps)
        yaw = now.yaw_rad[:, -1:] * np.ones(4)
        ahead = np.stack((np.cos(yaw), np.sin(yaw)), -1) * (speed * times)[..., None]
        tracks = Tracks(
            ids=now.ids,
            classes=now.classes,
            size_m=now.size_m,
            xy_m=now.xy_m[:, -1:] + ahead,
            yaw_rad=yaw,
            speed_mps=speed,
            valid=np.ones_like(yaw, dtype=np.bool_),
            t0_s=scene.time_s + 0.5,
            dt_s=0.5,
        )
        return JointPlan(tracks), None
