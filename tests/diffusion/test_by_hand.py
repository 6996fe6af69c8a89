"""Gradients of the forms for run time, against those of the networks and against differences."""

from __future__ import annotations

from dataclasses import fields

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.exported_step import step_package
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.fast_networks import fast_reward, reward_package
from advdiff_sumo.diffusion.machine_code import slope_of
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Forced, Rollout
from advdiff_sumo.models.shipped_weights import shipped_weights
from tests.diffusion.shipped_code import assert_close, checked_against_networks, needs_code
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


def assert_used(errors: dict[str, list[float]], weights: str) -> None:
    """Check that the step's code and that of its slope served, and were near the network."""
    step = step_package(load_bundle(shipped_weights(weights)).options.model)
    assert_close(errors, step.stem, slope_of(step).stem)


def assert_near(*pairs: tuple[Tensor, ...]) -> None:
    """Check that states and slopes differ by what rounding has become over the steps."""
    for (mine, theirs), share in zip(pairs, (1e-5, 1e-4), strict=True):
        torch.testing.assert_close(mine, theirs, atol=share * float(theirs.abs().max()), rtol=0.0)


@needs_code
@pytest.mark.parametrize("weights", ["traffic", "closed-loop"])
@pytest.mark.parametrize("rows", [[5, 2], [2], [1, 3, 7]])
def test_some_rows_by_machine_code_as_by_the_network(rows: list[int], weights: str) -> None:
    networks = load_bundle(shipped_weights(weights)).frozen()
    generator, sizes = torch.Generator().manual_seed(4), networks.options.model
    batch, picked = scenes(8), torch.tensor(rows)
    z, h = (torch.randn(2, 8, n, generator=generator) for n in (sizes.latent, sizes.hidden))
    results = []
    with checked_against_networks() as errors:
        for compiled in (True, False):
            fast = FastDecoder(networks.traffic.decoder, compiled)
            _, trace = fast.whole(z, h, batch, 6)
            free = (z[:, picked] + 0.3).requires_grad_()
            some = fast.some(free, h, batch, picked, 6, trace)
            results.append((some.states().detach(), torch.autograd.grad(weighed(some).sum(), free)[0]))
    assert_used(errors, weights)
    assert results[1][1].abs().max() > 1e-3
    assert_near(*zip(*results, strict=True))


@needs_code
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
    with checked_against_networks() as errors:
        for compiled in (True, False):
            free = z.clone().requires_grad_()
            made = FastDecoder(networks.traffic.decoder, compiled)(free, h, batch, 6, given)
            states = made.states()[batch.present].detach()
            results.append((states, torch.autograd.grad(weighed(made).sum(), free)[0]))
    assert_used(errors, weights)
    assert_near(*zip(*results, strict=True))


def test_some_rows_against_differences(made: Bundle) -> None:
    batch, context = two_scenes(made)
    picked = torch.tensor([4, 1])
    fast = FastDecoder(made.traffic.decoder)
    _, trace = fast.whole(context.prior.mean, context.h, batch, 4)

    def value(z: Tensor) -> Tensor:
        return weighed(fast.some(z, context.h, batch, picked, 4, trace))

    free = context.prior.mean[:, picked].clone().requires_grad_()
    assert torch.autograd.gradcheck(value, (free,), fast_mode=True, atol=1e-5, rtol=1e-4)


@needs_code
@pytest.mark.parametrize("weights", ["traffic", "closed-loop"])
def test_q_by_machine_code_and_its_gradient(weights: str) -> None:
    networks = load_bundle(shipped_weights(weights)).frozen()
    generator, sizes = torch.Generator().manual_seed(4), networks.options.model
    batch, target = scene(scenes=2, agents=8), torch.tensor([0, 3])
    batch.present[1, 6:] = batch.moved[1, 6:] = False
    h, z, mu = (torch.randn(2, 8, n, generator=generator) for n in (sizes.hidden, sizes.latent, sizes.latent))
    state, weight = networks.reward.prepare(h, z, batch, target), torch.tensor([1.0, -2.0])
    results = []
    with checked_against_networks() as errors:
        for compiled in (True, False):
            free, objective = (
                mu.clone().requires_grad_(),
                fast_reward(networks.reward, compiled)(state),
            )
            value = objective(free)
            slope = torch.autograd.grad((value * weight).sum(), free)[0]
            results.append((value.detach(), slope, objective.slope(mu)))
    package = reward_package(sizes)
    assert_close(errors, package.stem, slope_of(package).stem)
    for mine, theirs in zip(*results, strict=True):
        torch.testing.assert_close(mine, theirs, atol=1e-6 * float(theirs.abs().max()), rtol=0.0)
    assert results[0][1][0].abs().sum(-1).gt(0.0).tolist() == [False] + [True] * 7


def test_q_against_differences(made: Bundle) -> None:
    batch, context = two_scenes(made)
    state = made.reward.prepare(context.h, context.prior.mean, batch, torch.tensor([0, 3]))
    mu = torch.randn(2, 8, SMALL.latent, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    value_of = fast_reward(made.reward)(state)
    assert torch.autograd.gradcheck(value_of, (mu.requires_grad_(),), fast_mode=True)
