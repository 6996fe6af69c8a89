"""The observation of an attacker, worked by hand on a straight lane of a shipped net."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.planning.futures import constant_velocity_futures
from advdiff_sumo.traffic.planning.lanes_ahead import lanes_ahead
from advdiff_sumo.traffic.rl.features import FEATURES, LIMIT, OTHERS, observe
from advdiff_sumo.traffic.rl.prior import load_prior
from advdiff_sumo.traffic.rl.rl_situation import situation

Street = Callable[..., Scene]
OWN, LANE, TARGET = slice(0, 7), slice(7, 14), slice(14, 36)


def seen(road: RoadMap, scene: Scene, row: int = 1) -> np.ndarray:
    """Return the observation of the vehicle in *row* of the view if all vehicles keep their velocity."""
    view = look(road, scene)
    now = view.now
    futures = constant_velocity_futures(
        now.xy_m[:, -1], now.yaw_rad[:, -1], now.speed_mps[:, -1], now.size_m, steps=8, dt_s=0.5
    )
    lane = lanes_ahead(road, now.xy_m[[row], -1], now.yaw_rad[[row], -1], [()])[0]
    return observe(road, now, futures, row, lane, (0.4, 0.01))


def test_a_vehicle_behind_the_target(downtown: RoadMap, street: Street) -> None:
    """12 m behind, 0.5 m to the left of the lane, 2 m/s faster; there are no others."""
    found = seen(downtown, street([(60.0, 0.0), (48.0, 0.5)], [8.0, 10.0]))
    assert found.shape == (FEATURES,)
    assert found[OWN] == pytest.approx([1.0, 0.0, 0.0, 0.92, 0.95, 0.1, 0.5], abs=1e-9)
    assert found[LANE][:3] == pytest.approx([1.0, 0.25, 0.0], abs=1e-3)
    target = found[TARGET]
    assert target[:7] == pytest.approx([0.6, -0.025, 1.0, 0.0, -0.2, 0.0, 1.0], abs=1e-6)
    apart = np.hypot(12.0, 0.5)
    assert target[7] == pytest.approx(np.exp(-0.1 * apart))
    assert target[8] == pytest.approx(0.1 * (12.0 - 4.6))
    assert target[13:19] == pytest.approx(0.05 * np.array([10.0, -0.5, 8.0, -0.5, 6.0, -0.5]), abs=1e-6), (
        "2 m nearer every second"
    )
    assert target[19] == pytest.approx(0.05 * np.hypot(4.0, 0.5), abs=1e-6)
    assert target[20] == pytest.approx(1.0)
    assert target[21] == pytest.approx(0.8)
    assert (found[36:] == 0.0).all(), "there are no others"


def test_the_nearest_others_come_first(downtown: RoadMap, street: Street) -> None:
    places = [(100.0, 0.0), (80.0, 0.0), (50.0, 0.0), (72.0, 0.0), (90.0, 0.0), (20.0, 0.0)]
    view = look(downtown, street(places, [5.0] * 6))
    row = view.ids.index("v1")
    others = seen(downtown, street(places, [5.0] * 6), row)[36:].reshape(OTHERS, 8)
    assert others[:, 0] == pytest.approx([0.05 * -8.0, 0.05 * 10.0, 0.05 * -30.0], abs=1e-6)
    assert (others[:, 6] == 1.0).all()


def test_it_is_finite_off_the_lanes_and_without_a_past(downtown: RoadMap, street: Street) -> None:
    scene = street([(60.0, 0.0), (48.0, 0.0)], [8.0, 10.0])
    valid = scene.history.valid.copy()
    valid[1, :-1] = False
    history = replace(
        scene.history,
        valid=valid,
        xy_m=np.where(valid[..., None], scene.history.xy_m, np.nan),
        yaw_rad=np.where(valid, scene.history.yaw_rad, np.nan),
        speed_mps=np.where(valid, scene.history.speed_mps, np.nan),
    )
    found = seen(downtown, replace(scene, history=history))
    assert np.isfinite(found).all()
    assert (np.abs(found) <= LIMIT).all()
    view = look(downtown, scene)
    now = view.now
    futures = constant_velocity_futures(
        now.xy_m[:, -1], now.yaw_rad[:, -1], now.speed_mps[:, -1], now.size_m, steps=8, dt_s=0.5
    )
    assert (observe(downtown, now, futures, 1, None, (0.0, 0.0))[LANE][:6] == 0.0).all()


def test_there_is_no_attacker_if_none_can_attack(downtown: RoadMap, street: Street, weights: str) -> None:
    scene = street([(60.0, 0.0), (75.0, 0.0)], [8.0, 7.0])
    alone = replace(scene, movable=np.zeros(2, dtype=np.bool_))
    prior = load_prior("traffic", weights)
    found = situation(downtown, alone, prior, 1, (), "reckless")
    assert found.attackers == ()
    assert found.observations.shape == (0, FEATURES)
    assert situation(downtown, scene, prior, 1, (), "reckless").attackers == ("v1",)


def test_the_previous_attacker_is_kept(downtown: RoadMap, street: Street, weights: str) -> None:
    scene = street([(60.0, 0.0), (72.0, 0.0), (46.0, 0.0)], [8.0, 8.0, 8.0])
    prior = load_prior("traffic", weights)
    assert Path(weights).exists()
    first = situation(downtown, scene, prior, 1, (), "reckless").attackers
    other = tuple({"v1", "v2"} - set(first))
    assert situation(downtown, scene, prior, 1, other, "reckless").attackers == other
