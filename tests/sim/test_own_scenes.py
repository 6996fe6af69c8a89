"""Plug-ins may modify the scenes that they are given: these are copies, and no other episode changes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import JointPlan, Plan, Trajectory
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects import DEFECTS, parse_defects, plant
from advdiff_sumo.planners.planner_protocol import Planner, SumoDriver
from advdiff_sumo.sim.seed_scene import SeedScene
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy
from tests.sim.scenes import StraightOn, episode


def spoil(scene: Scene) -> None:
    """Write nonsense into every writable part of *scene*."""
    history = scene.history
    for array in (history.size_m, history.xy_m, history.yaw_rad, history.speed_mps):
        array[...] = 3.0
    history.classes[:] = 5
    history.valid[:] = False
    scene.movable[:] = False
    scene.signals.clear()  # type: ignore[attr-defined] # a planner does what it likes with a dictionary


class Steady:
    """Keeps its speed, brakes a little for nearby vehicles, and spoils its scene on request."""

    def __init__(self, spoils: bool) -> None:
        self.spoils = spoils

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Nothing to remember."""
        self._leave(scene)

    def plan(self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator) -> tuple[Plan, None]:
        """Return 2 s straight on, with a deceleration that depends on the number of road users."""
        history, row = scene.history, scene.target
        speed = history.speed_mps[row, -1] * np.exp(-0.02 * history.agents * np.arange(1, 21))
        yaw = np.full(20, history.yaw_rad[row, -1])
        xy = history.xy_m[row, -1] + np.cumsum(0.1 * speed[:, None] * unit(yaw), axis=0)
        self._leave(scene)
        return Trajectory(xy, yaw, speed, 0.1), None

    def _leave(self, scene: Scene) -> None:
        if self.spoils:
            spoil(scene)


class Spoiling(StraightOn):
    """The same traffic, which spoils everything that it was given."""

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> None:
        """Spoil scene and log."""
        spoil(scene)
        if log is not None:
            log.xy_m[...] = 0.0

    def plan(
        self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[JointPlan, None]:
        """Plan, and spoil the scene."""
        planned = super().plan(road, scene, memory, rng)
        spoil(scene)
        return planned


def recorded(scene: SeedScene, road: RoadMap, target: Any, policy: TrafficPolicy) -> EpisodeRecord:
    record, _ = episode(scene, road, target, policy, 2.0).run()
    assert record.failure is None
    return record


def prints(record: EpisodeRecord) -> Iterator[bytes]:
    """Yield everything that was recorded."""
    tracks = record.tracks
    for array in (tracks.xy_m, tracks.yaw_rad, tracks.speed_mps, tracks.size_m, tracks.classes, tracks.valid):
        yield array.tobytes()
    yield record.controller.tobytes()
    yield repr((tracks.ids, record.signals)).encode()
    for plans in record.plans:
        yield repr(plans.ids).encode() + plans.xy_m.tobytes()


def test_a_planner_that_writes_into_its_scene_spoils_nothing(scene: SeedScene, road: RoadMap) -> None:
    clean, spoilt = (recorded(scene, road, Steady(spoils), StraightOn()) for spoils in (False, True))
    assert clean.plans
    assert list(prints(clean)) == list(prints(spoilt))


@pytest.mark.parametrize("defect", DEFECTS)
def test_nor_does_it_spoil_a_defect(scene: SeedScene, road: RoadMap, defect: str) -> None:
    def planted(spoils: bool) -> Planner:
        target = plant(Steady(spoils), parse_defects([f"{defect}:middle"]), "steady")
        assert not isinstance(target, SumoDriver)
        return target

    clean, spoilt = (recorded(scene, road, planted(spoils), StraightOn()) for spoils in (False, True))
    assert list(prints(clean)) == list(prints(spoilt))


def test_traffic_that_writes_into_what_it_is_given_spoils_nothing(scene: SeedScene, road: RoadMap) -> None:
    before = scene.log.xy_m.tobytes()
    clean, spoilt = (recorded(scene, road, Steady(False), policy) for policy in (StraightOn(), Spoiling()))
    assert list(prints(clean)) == list(prints(spoilt))
    assert scene.log.xy_m.tobytes() == before


def test_a_copy_is_equal_and_shares_nothing(scene: SeedScene) -> None:
    tracks = scene.history
    moved = np.zeros(tracks.agents, dtype=np.bool_)
    original = Scene(tracks, 0, moved, ((),) * tracks.agents, {"light": "rG"})
    copy = original.copied()
    assert copy.history.ids == tracks.ids
    for name in ("classes", "size_m", "xy_m", "yaw_rad", "speed_mps", "valid"):
        ours, theirs = getattr(tracks, name), getattr(copy.history, name)
        np.testing.assert_array_equal(ours, theirs)
        assert not np.shares_memory(ours, theirs)
    spoil(copy)
    assert original.signals == {"light": "rG"}
