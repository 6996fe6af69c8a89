"""The pace of natural plans."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.bundle import BundleOptions, load_bundle, new_bundle
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.models.view import look
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionTraffic
from advdiff_sumo.traffic.diffusion.draw import draw_plan
from advdiff_sumo.traffic.planning.pace import faster_latent, with_pace
from tests.traffic.small_networks import MODEL

Street = Callable[..., Scene]
PLACES, SPEEDS = [(60.0, 0.0), (75.0, 0.0), (45.0, 0.0)], [4.0, 7.0, 0.0]


def test_standing_vehicles_are_shifted_most_and_attackers_not_at_all() -> None:
    x = torch.full((1, 5, 1, 2), 3.0)
    speed, share = torch.tensor([[0.0, 4.0, 8.0, 20.0, 0.0]]), torch.tensor([1.0, 1.0, 1.0, 0.5, 0.0])
    shifted = with_pace(x, torch.tensor([[0.0, 1.0]]), speed, share)
    assert torch.equal(shifted[..., 0], x[..., 0])
    expected = torch.tensor([4.12, 3.67, 3.22, 3.11, 3.0])
    torch.testing.assert_close(shifted[0, :, 0, 1], expected)


def test_the_direction_makes_vehicles_of_the_shipped_networks_faster(
    downtown: RoadMap, street: Street
) -> None:
    """On a street, not in the scene of the isolated car."""
    policy = DiffusionTraffic(guide="none", temperature=0.0, pace=0.0)
    view = look(downtown, street(PLACES, SPEEDS))
    brisk = policy.options.model_copy(update={"pace": 1.0})
    assert float(policy.networks.faster.norm()) == pytest.approx(1.0)
    before, after = (
        draw_plan(policy.networks, options, view, {}, {}, 1) for options in (policy.options, brisk)
    )
    faster = (after.rollout.speed - before.rollout.speed)[0, :, -1].numpy()
    moved = view.batch.moved[0].numpy()
    assert faster[moved].mean() > 0.3
    assert np.all(faster[moved] > -0.1)


def test_reckless_plans_are_not_shifted() -> None:
    assert DiffusionTraffic(licence="reckless").options.briskness == 0.0
    assert DiffusionTraffic().options.briskness == 1.0
    assert DiffusionTraffic(pace=0.5).options.briskness == 0.5


def test_there_is_no_direction_for_diffused_trajectories() -> None:
    direction = faster_latent(new_bundle(BundleOptions.parse({"model": MODEL, "codec": "trajectory"})))
    assert direction.ndim == 2
    assert not direction.any()


def test_the_direction_is_deterministic() -> None:
    bundle = load_bundle(shipped_weights())
    assert torch.equal(faster_latent(bundle), faster_latent(bundle))
