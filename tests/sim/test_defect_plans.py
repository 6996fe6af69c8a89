"""A defect changes what is driven, never which plans are accepted: plans are refused with the same message."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import Controls, Plan, Trajectory
from advdiff_sumo.core.plan_form import plan_arrays
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.defects import DEFECTS, parse_defects, plant
from advdiff_sumo.sim.seed_scene import SeedScene
from tests.sim.scenes import episode

ACTS = ("localisation", "weak-brakes", "slow-brakes", "stuck")
SECOND = 0.1 * np.arange(1, 21)


class Gives:
    """A planner whose plan is the result of a given function."""

    def __init__(self, answer: Callable[[Scene], Any]) -> None:
        self.answer = answer

    def start(self, road: RoadMap, scene: Scene, rng: np.random.Generator) -> None:
        """Nothing to remember."""

    def plan(self, road: RoadMap, scene: Scene, memory: None, rng: np.random.Generator) -> Any:
        return self.answer(scene)


def trajectory(scene: Scene, **parts: Any) -> Trajectory:
    """Return 2 s straight on, with other *parts*."""
    history, row = scene.history, scene.target
    speed, yaw = np.full(20, history.speed_mps[row, -1]), np.full(20, history.yaw_rad[row, -1])
    xy = history.xy_m[row, -1] + SECOND[:, None] * speed[:, None] * unit(yaw)
    return replace(Trajectory(xy, yaw, speed, 0.1), **parts)


def controls(accel: Any = 0.0, steer: Any = 0.0, dt_s: Any = 0.1) -> Controls:
    return Controls(*(np.full(20, x) if isinstance(x, float) else x for x in (accel, steer)), dt_s)


def as_type(plan: Plan, dtype: type) -> Plan:
    return replace(plan, **{name: getattr(plan, name).round().astype(dtype) for name in plan_arrays(plan)})


def recorded(scene: SeedScene, road: RoadMap, answer: Callable[[Scene], Any], *defects: str) -> EpisodeRecord:
    target = plant(Gives(answer), parse_defects([f"{defect}:strong" for defect in defects]), "gives")
    return episode(scene, road, target, "sumo", 2.0).run()[0]


REFUSED: dict[str, Callable[[Scene], Any]] = {
    "lists": lambda _: (Controls([-1.0] * 20, [0.0] * 20, 0.1), None),  # type: ignore[arg-type] # on purpose
    "lists of a trajectory": lambda s: (trajectory(s, speed_mps=[1.0] * 20), None),
    "shape": lambda s: (trajectory(s, xy_m=trajectory(s).xy_m.T), None),
    "lengths": lambda s: (trajectory(s, speed_mps=np.ones(7)), None),
    "columns": lambda _: (controls(np.zeros((20, 1))), None),
    "no numbers": lambda _: (controls(np.array([None] * 20)), None),
    "no array": lambda _: (Controls(None, np.zeros(20), 0.1), None),  # type: ignore[arg-type] # on purpose
    "nan": lambda _: (controls(np.nan), None),
    "nan in places": lambda s: (trajectory(s, speed_mps=np.where(SECOND > 1.0, np.nan, 5.0)), None),
    "jump": lambda s: (trajectory(s, xy_m=trajectory(s).xy_m + 50.0), None),
    "braking that is none": lambda _: (controls(-60.0), None),
    "empty": lambda _: (controls(np.zeros(0), np.zeros(0)), None),
    "too short": lambda _: (controls(np.zeros(3), np.zeros(3)), None),
    "interval": lambda _: (controls(-1.0, dt_s=None), None),
    "text as interval": lambda s: (trajectory(s, dt_s="0.1"), None),
    "nothing": lambda _: None,
    "no plan": lambda _: (None, None),
    "a plan alone": trajectory,
    "raises": lambda _: 1 // 0,
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused_is_refused_in_the_same_words(scene: SeedScene, road: RoadMap, case: str) -> None:
    sound = recorded(scene, road, REFUSED[case]).failure
    assert sound is not None
    assert re.search(r" \(test_defect_plans\.py, line \d+, .+\)$", sound.message)
    for defect in ACTS:
        failure = recorded(scene, road, REFUSED[case], defect).failure
        assert failure is not None
        assert (failure.kind, failure.message, failure.time_s) == (sound.kind, sound.message, sound.time_s), (
            defect
        )


@pytest.mark.parametrize("defect", DEFECTS)
def test_each_defect_names_the_planners_own_method(scene: SeedScene, road: RoadMap, defect: str) -> None:
    failure = recorded(scene, road, REFUSED["lists"], "late", *({defect} - {"late"})).failure
    assert failure is not None
    line = inspect.getsourcelines(Gives.plan)[1]
    assert failure.message.endswith(f"not a NumPy array (test_defect_plans.py, line {line}, plan)")


@pytest.mark.parametrize("dtype", [np.int64, np.int8, np.float32])
@pytest.mark.parametrize("defect", ACTS)
def test_numbers_of_any_type_are_driven_as_what_they_say(
    scene: SeedScene, road: RoadMap, defect: str, dtype: type
) -> None:
    brakes = controls(-3.0)
    exact = recorded(scene, road, lambda _: (brakes, None), defect)
    other = recorded(scene, road, lambda _: (as_type(brakes, dtype), None), defect)
    assert exact.failure is None
    assert exact.tracks.xy_m.tobytes() == other.tracks.xy_m.tobytes()


def test_trajectories_in_whole_numbers_too(scene: SeedScene, road: RoadMap) -> None:
    for defect in ACTS:
        exact, whole = (
            recorded(scene, road, lambda s, t=dtype: (as_type(trajectory(s), t), None), defect)  # type: ignore[misc] # bound at once
            for dtype in (np.float64, np.int64)
        )
        assert exact.failure is None
        assert exact.tracks.xy_m.tobytes() == whole.tracks.xy_m.tobytes(), defect
