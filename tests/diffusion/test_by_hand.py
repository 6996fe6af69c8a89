"""Gradients of the forms for run time, against those of the networks and against differences."""

from __future__ import annotations

from dataclasses import fields

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.fast_reward import FastReward
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Forced, Rollout
from advdiff_sumo.models.shipped_weights import shipped_weights
from tests.diffusion.test_exported_step import scenes
from tests.diffusion.test_fast import SMALL, bundle, scene

PARTS = ("xy", "yaw", "speed", "accel", "curvature")


def double(batch: SceneBatch) -> SceneBatch:
    parts = {f.name: getattr(batch, f.name) for f in fields(batch)}
    return SceneBatch(**{n: v.double() if v.is_floating_point() else v for n, v in parts.items()})


@pytest.fixture(scope="module")
def made() -> Bundle:
    networks = bundle()
    for module in networks.modules().values():
        module.double()
    return networks


def two_scenes(networks: Bundle) -> tuple[SceneBatch, Context]:
    """Return two scenes of eight in double precision, and their context."""
    batch = double(crowded())
    return batch, networks.traffic.encoder(batch)


def crowded() -> SceneBatch:
    """Return two scenes of eight, with somebody absent, on foot, and standing."""
    batch = scene(scenes=2, agents=8)
    batch.present[1, 6:] = False
    batch.moved[1, 6:] = False
    batch.moved[0, 5] = False
    batch.past[0, 2, :, 3] = 0.05
    return batch


def weighed(rollout: Rollout) -> Tensor:
    """Return a sum in which every number of a roll-out counts differently."""
    generator = torch.Generator().manual_seed(5)
    total = torch.zeros((), dtype=rollout.yaw.dtype)
    for name in PARTS:
        part = getattr(rollout, name)
        total = total + (part * torch.randn(part.shape, generator=generator, dtype=part.dtype)).sum()
    return total


@pytest.mark.parametrize("weights", ["traffic", "closed-loop"])
@pytest.mark.parametrize("rows", [[5, 2], [2], [1, 3, 7]])
def test_some_rows_by_machine_code_as_by_the_network(rows: list[int], weights: str) -> None:
    networks = load_bundle(shipped_weights(weights)).frozen()
    generator, sizes = torch.Generator().manual_seed(4), networks.options.model
    batch, picked = scenes(8), torch.tensor(rows)
    z, h = (torch.randn(2, 8, n, generator=generator) for n in (sizes.latent, sizes.hidden))
    results = []
    for compiled in (True, False):
        fast = FastDecoder(networks.traffic.decoder, compiled)
        _, trace = fast.whole(z, h, batch, 6)
        free = (z[:, picked] + 0.3).requires_grad_()
        some = fast.some(free, h, batch, picked, 6, trace)
        results.append((some.states().detach(), torch.autograd.grad(weighed(some).sum(), free)[0]))
    (states, slope), (wanted_states, wanted) = results
    assert wanted.abs().max() > 1e-3
    torch.testing.assert_close(states, wanted_states, atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(slope, wanted, atol=2e-3 * float(wanted.abs().max()), rtol=1e-2)


@pytest.mark.parametrize("forced", [False, True], ids=["free", "the target is given"])
@pytest.mark.parametrize("weights", ["traffic", "closed-loop"])
def test_everybody_by_machine_code_as_by_the_network(weights: str, forced: bool) -> None:
    """As Strive searches: what one does changes what the others see."""
    networks = load_bundle(shipped_weights(weights)).frozen()
    generator, sizes, batch = torch.Generator().manual_seed(4), networks.options.model, scenes(8)
    z, h = (torch.randn(2, 8, n, generator=generator) for n in (sizes.latent, sizes.hidden))
    mask = torch.zeros(2, 8, 6, dtype=torch.bool)
    mask[:, 0] = True
    given = Forced(torch.randn(2, 8, 6, 4, generator=generator).abs(), mask) if forced else None
    results = []
    for compiled in (True, False):
        free = z.clone().requires_grad_()
        made = FastDecoder(networks.traffic.decoder, compiled)(free, h, batch, 6, given)
        results.append((made.states().detach(), torch.autograd.grad(weighed(made).sum(), free)[0]))
    (states, slope), (wanted_states, wanted) = results
    there = batch.present
    torch.testing.assert_close(states[there], wanted_states[there], atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(slope, wanted, atol=2e-3 * float(wanted.abs().max()), rtol=1e-2)


def test_some_rows_against_differences(made: Bundle) -> None:
    batch, context = two_scenes(made)
    picked = torch.tensor([4, 1])
    fast = FastDecoder(made.traffic.decoder)
    _, trace = fast.whole(context.prior.mean, context.h, batch, 4)

    def value(z: Tensor) -> Tensor:
        return weighed(fast.some(z, context.h, batch, picked, 4, trace))

    free = context.prior.mean[:, picked].clone().requires_grad_()
    assert torch.autograd.gradcheck(value, (free,), fast_mode=True, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("weights", ["traffic", "closed-loop"])
def test_q_by_machine_code_and_its_gradient(weights: str) -> None:
    networks = load_bundle(shipped_weights(weights)).frozen()
    generator, sizes = torch.Generator().manual_seed(4), networks.options.model
    batch, target = scene(scenes=2, agents=8), torch.tensor([0, 3])
    batch.present[1, 6:] = batch.moved[1, 6:] = False
    h, z, mu = (torch.randn(2, 8, n, generator=generator) for n in (sizes.hidden, sizes.latent, sizes.latent))
    state, weight = networks.reward.prepare(h, z, batch, target), torch.tensor([1.0, -2.0])
    results = []
    for compiled in (True, False):
        free = mu.clone().requires_grad_()
        value = FastReward(networks.reward, compiled).condition(state)(free)
        results.append((value.detach(), torch.autograd.grad((value * weight).sum(), free)[0]))
    for mine, theirs in zip(*results, strict=True):
        torch.testing.assert_close(mine, theirs, atol=1e-5, rtol=1e-4)
    assert results[0][1][0].abs().sum(-1).gt(0.0).tolist() == [False] + [True] * 7


def test_q_against_differences(made: Bundle) -> None:
    batch, context = two_scenes(made)
    state = made.reward.prepare(context.h, context.prior.mean, batch, torch.tensor([0, 3]))
    mu = torch.randn(2, 8, SMALL.latent, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    value_of = FastReward(made.reward).condition(state)
    assert torch.autograd.gradcheck(value_of, (mu.requires_grad_(),), fast_mode=True)
