"""What attackers meet, by machine code and by tensors: the same costs and gradients; and by hand."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.attack import CostsOnTensors, costs_package
from advdiff_sumo.diffusion.attack_costs import COSTS
from advdiff_sumo.diffusion.bodies import AttackStates, attack_distances
from advdiff_sumo.diffusion.machine_code import machine_code, slope_of
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from tests.diffusion.shipped_code import assert_close, checked_against_networks, needs_code
from tests.diffusion.test_by_hand import double
from tests.diffusion.test_fast import scene

STEPS = 6


def futures(scenes: int, agents: int, seed: int) -> Rollout:
    """Return futures anywhere within a dozen metres, so that many bodies touch."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    xy, yaw = 6.0 * normal(scenes, agents, STEPS, 2), 2.0 * normal(scenes, agents, STEPS)
    return Rollout(xy, yaw, yaw.abs(), yaw, yaw)


def crowd(edges: bool) -> SceneBatch:
    batch = double(scene(agents=7))
    batch.size[0, 3] = torch.tensor([0.6, 0.6])
    batch.moved[0, 4] = False
    batch.map_valid[0, :, 30:] = edges
    batch.map_features[..., 4] = 0.0
    batch.map_features[0, :, 30:, 4] = 1.0
    batch.map_xy.mul_(0.4)
    return batch


@needs_code
@pytest.mark.parametrize("edges", [True, False])
@pytest.mark.parametrize("rows", [[2], [4, 1], [1, 2, 3, 4, 5, 6]])
def test_values_and_gradients(rows: list[int], edges: bool) -> None:
    """With somebody on foot, with edges and without, and where nobody else is there."""
    placed = AttackStates.of(crowd(edges), torch.tensor(rows), futures(1, 7, 1))
    driven = futures(3, len(rows), 2)
    met = attack_distances(driven, placed)
    assert (met.off > 0.0).any() == edges
    assert (met.overlap > 0.0).any() == (len(rows) < 6)
    code = machine_code(costs_package(), CostsOnTensors())
    assert code is not None
    shares = torch.linspace(0.1, 1.0, len(COSTS))
    held = [shares, *(x.float() if x.is_floating_point() else x for x in placed.tensors())]
    weight = torch.randn(3, len(rows), generator=torch.Generator().manual_seed(3))
    free = [x.float().requires_grad_() for x in (driven.xy, driven.yaw, driven.speed)]
    with checked_against_networks() as errors:
        torch.autograd.grad((weight * code(free, held)[0]).sum(), free)
    assert_close(errors, *(package(costs_package()).stem for package in (Path, slope_of)))


def test_in_line_the_slope_is_the_mean_of_all_nearest_discs() -> None:
    """Side by side five pairs of discs are equally near: closer by sideways motion alone, not by turning."""
    batch = double(scene(agents=2))
    natural, driven = futures(1, 2, 0), futures(1, 1, 0)
    natural.xy[:], natural.yaw[:] = 0.0, 0.0
    driven.xy[:] = torch.tensor([0.0, 3.0], dtype=torch.float64)
    yaw = torch.zeros_like(driven.yaw).requires_grad_()
    xy = driven.xy.requires_grad_()
    met = attack_distances(
        Rollout(xy, yaw, yaw, yaw, yaw), AttackStates.of(batch, torch.tensor([1]), natural)
    )
    by_xy, by_yaw = torch.autograd.grad(met.gap.sum(), (xy, yaw))
    torch.testing.assert_close(met.gap.detach(), torch.full((1, 1, STEPS), 1.1).double(), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(by_xy, torch.tensor([0.0, 1.0]).double().expand_as(by_xy))
    torch.testing.assert_close(by_yaw, torch.zeros_like(by_yaw))
