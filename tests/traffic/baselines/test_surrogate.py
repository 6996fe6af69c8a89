"""The target driven by a surrogate among planned futures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.plan import Controls, Trajectory
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.baselines.surrogate import ask, drive_surrogate, make_surrogate, states_of
from advdiff_sumo.traffic.planning.futures import constant_velocity_futures

Street = Callable[..., Scene]


def test_states_of_a_trajectory(street: Street) -> None:
    """1 m each 0.1 s from the target's centre: 5 m after half a second, 10 m after one second."""
    scene = street([(60.0, 0.0)], [10.0])
    here, yaw = scene.history.xy_m[0, -1], float(scene.history.yaw_rad[0, -1])
    along = np.arange(1.0, 13.0)
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    plan = Trajectory(here + along[:, None] * ahead, np.full(12, yaw), np.full(12, 10.0), 0.1)
    states = states_of(plan, scene)
    np.testing.assert_allclose(states[:, :2], here + np.array([[5.0], [10.0]]) * ahead, atol=1e-9)
    np.testing.assert_allclose(states[:, 3], 10.0)


def test_states_of_controls(street: Street) -> None:
    """Braking at 4 m/s² from 10 m/s: 8 m/s after half a second and 4.5 m, 6 m/s after one second and 8 m."""
    scene = street([(60.0, 0.0)], [10.0])
    states = states_of(Controls(np.full(10, -4.0), np.zeros(10), 0.1), scene)
    np.testing.assert_allclose(states[:, 3], [8.0, 6.0])
    driven = np.linalg.norm(states[:, :2] - scene.history.xy_m[0, -1], axis=-1)
    np.testing.assert_allclose(driven, [4.5, 8.0], atol=1e-6)


def test_a_plan_too_short(street: Street) -> None:
    with pytest.raises(ConfigError, match=r"lasts 0\.1 s"):
        states_of(Controls(np.zeros(1), np.zeros(1), 0.1), street([(60.0, 0.0)], [10.0]))


def test_it_reacts_to_the_futures_of_the_others(downtown: RoadMap, street: Street) -> None:
    """The vehicle ahead drives on in one future and stands in the other."""
    scene = street([(40.0, 0.0), (60.0, 0.0)], [8.0, 8.0])
    view = look(downtown, scene)
    planner = make_surrogate("lane_graph")
    assert planner is not None
    now = view.now
    pose = now.xy_m[:, -1], now.yaw_rad[:, -1]
    going = constant_velocity_futures(*pose, np.array([8.0, 8.0]), now.size_m, 12, 0.5)
    stopped = constant_velocity_futures(*pose, np.array([8.0, 0.0]), now.size_m, 12, 0.5)
    made = []
    for futures in (going, stopped):
        memory = planner.start(downtown, scene, np.random.default_rng(0))
        answer = ask(downtown, planner, view, memory, 0)
        assert answer.memory is not None
        made.append(drive_surrogate(downtown, planner, view, futures, answer, 8))
    free, braked = (np.linalg.norm(x[-1, :2] - now.xy_m[0, -1]) for x in made)
    assert free > 25.0
    assert braked < 20.0 - 4.6 + 0.1
    assert all(x.shape == (8, 4) for x in made)


def test_the_models_prediction_needs_no_planner() -> None:
    assert make_surrogate("model") is None
