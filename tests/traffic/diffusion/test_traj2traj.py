"""The ablation in closed loop: diffused trajectories, without a vehicle model, become plans that can be driven."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from advdiff_sumo.core.errors import ConfigError, WeightsError
from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import BundleOptions, new_bundle, save_bundle
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionTraffic, Traj2Traj
from advdiff_sumo.traffic.diffusion.draw import without_jumps
from advdiff_sumo.traffic.policy_check import check_policy
from advdiff_sumo.traffic.policy_registry import make_policy
from tests.traffic.small_networks import MODEL

Street = Callable[..., Scene]
PLACES, SPEEDS = [(60.0, 0.0), (75.0, 0.0), (45.0, 0.0)], [8.0, 7.0, 9.0]


@pytest.fixture(scope="module")
def trajectories(tmp_path_factory: pytest.TempPathFactory) -> str:
    bundle = new_bundle(BundleOptions.parse({"model": MODEL, "codec": "trajectory"}))
    path = tmp_path_factory.mktemp("weights") / "trajectories.safetensors"
    save_bundle(bundle, path, ())
    return str(path)


def test_it_keeps_the_contract_of_a_policy(trajectories: str, downtown: RoadMap, street: Street) -> None:
    scene = street(PLACES, SPEEDS)
    assert check_policy(make_policy("traj2traj", {"weights": trajectories}), downtown, scene, None) == []


def test_it_reads_its_own_shipped_networks(downtown: RoadMap, street: Street) -> None:
    policy = make_policy("traj2traj", {})
    assert isinstance(policy, Traj2Traj)
    assert policy.networks.codec.shape == (3, 12)
    scene = street(PLACES, SPEEDS)
    plans = []
    for _ in range(2):
        memory = policy.start(downtown, scene, None, np.random.default_rng(0))
        plans.append(policy.plan(downtown, scene, memory, np.random.default_rng(3))[0].tracks)
    assert plans[0].xy_m.tobytes() == plans[1].xy_m.tobytes()
    assert np.abs(np.diff(plans[0].xy_m, axis=1)).max() <= 20.0 + 1e-4


def test_steps_longer_than_the_fastest_speed_allows_are_shortened(downtown: RoadMap, street: Street) -> None:
    """40 m/s is 20 m in half a second: a step of 50 m becomes 20 m, one of 3 m is unchanged."""
    batch: SceneBatch = look(downtown, street(PLACES, SPEEDS)).batch
    moves = torch.zeros(*batch.pose.shape[:2], 2, 2)
    moves[..., 0, 0], moves[..., 1, 1] = 50.0, 3.0
    flat = torch.zeros(moves.shape[:-1])
    xy = batch.pose[:, :, None, :2] + moves.cumsum(2)
    made = without_jumps(Rollout(xy, flat, flat - 5.0, flat, flat), batch)
    first, second = (made.xy - batch.pose[:, :, None, :2]).unbind(2)
    torch.testing.assert_close(first, torch.tensor([20.0, 0.0]).expand_as(first), atol=1e-3, rtol=0.0)
    torch.testing.assert_close(second, torch.tensor([20.0, 3.0]).expand_as(second), atol=1e-3, rtol=0.0)
    assert float(made.speed.abs().max()) == 0.0


def test_trajectories_cannot_be_guided(trajectories: str) -> None:
    with pytest.raises(WeightsError, match="diffuses trajectories, which nothing guides"):
        DiffusionTraffic(weights=trajectories)
    with pytest.raises(ConfigError, match="guide"):
        make_policy("traj2traj", {"weights": trajectories, "guide": "reward"})
