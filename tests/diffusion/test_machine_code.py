"""Every package that ships does what the network does, and is not asked about what it is not for."""

from __future__ import annotations

from functools import cache

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.attack import AttackScene, Natural, plain_objective
from advdiff_sumo.diffusion.attack_costs import COSTS
from advdiff_sumo.diffusion.attack_slope import SlopedAttack, attack_code
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.fast_denoiser import FastDenoiser
from advdiff_sumo.diffusion.fast_reward import FastReward
from advdiff_sumo.diffusion.guides import autograd_slope
from advdiff_sumo.diffusion.machine_code import MachineCode
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.traffic.diffusion.guidance import HORIZON_STEPS, NEAR_STEPS
from tests.diffusion.shipped_code import TOLERANCE, checked_against_networks, names, needs_code
from tests.diffusion.test_exported_step import scenes

pytestmark = needs_code
SIZES = [(1, 1), (1, 2), (2, 5), (1, 13), (3, 30)]
"""Scenes and agents."""


@cache
def bundle(weights: str) -> Bundle:
    return load_bundle(shipped_weights(weights)).frozen()


@cache
def decoder(weights: str) -> FastDecoder:
    return FastDecoder(bundle(weights).traffic.decoder)


def drawn(batch: SceneBatch, *sizes: int) -> list[Tensor]:
    """Return numbers (B, A, …) of each size."""
    generator = torch.Generator().manual_seed(1)
    return [torch.randn(batch.scenes, batch.agents, size, generator=generator) for size in sizes]


def roll_out(weights: str, batch: SceneBatch) -> None:
    """Roll out everybody and some of them, without and with slopes."""
    sizes, rows = bundle(weights).options.model, torch.arange(batch.agents)[-2:]
    z, h = drawn(batch, sizes.latent, sizes.hidden)
    _, trace = decoder(weights).whole(z, h, batch, 4)
    for free, roll in (
        (z, lambda free: decoder(weights)(free, h, batch, 3)),
        (z[:, rows] + 0.5, lambda free: decoder(weights).some(free, h, batch, rows, 4, trace)),
    ):
        free = free.clone().requires_grad_()
        (slope,) = torch.autograd.grad(roll(free).states().sum(), free)
        assert bool(slope.any())


def value(weights: str, batch: SceneBatch) -> None:
    """Work out Q and its slope."""
    reward, sizes = bundle(weights).reward, bundle(weights).options.model
    h, z, mu = drawn(batch, sizes.hidden, sizes.latent, sizes.latent)
    state = reward.prepare(h, z, batch, torch.zeros(batch.scenes, dtype=torch.long))
    autograd_slope(FastReward(reward).condition(state), mu)


@torch.no_grad()
def predict(weights: str, batch: SceneBatch) -> None:
    """Predict noise at a step."""
    net = bundle(weights).denoiser
    (x,) = drawn(batch, net.shape[0] * net.shape[1])
    context = bundle(weights).traffic.encoder(batch)
    FastDenoiser(net).condition(context)(x.reshape(*x.shape[:2], *net.shape), 40)


def attackers(batch: SceneBatch, steps: int, weights: str = "traffic") -> AttackScene:
    """Return the last two of *batch*, or the only one, as attackers, in its first scene."""
    alone = SceneBatch(**{name: part[:1] for name, part in vars(batch).items()})
    networks = bundle(weights)
    context = networks.traffic.encoder(alone)
    natural = Natural(*decoder(weights).whole(context.prior.mean, context.h, alone, steps))
    assert isinstance(networks.codec, LatentCodec)
    rows = torch.arange(batch.agents)[1:][-2:]
    return AttackScene(decoder(weights), networks.codec, context, alone, rows, natural)


def attack(kind: str, batch: SceneBatch) -> tuple[Tensor, Tensor]:
    """Return the slopes of an attack in one package, and in one for each step and one for the costs."""
    given = attackers(batch, NEAR_STEPS if kind == "any" else HORIZON_STEPS)
    (latents,) = drawn(batch, bundle("traffic").options.model.latent)
    code = attack_code(given.decoder, given.natural.steps)
    assert code is not None
    return SlopedAttack(kind, given, code).slope(latents), autograd_slope(plain_objective(kind, given), latents)


@pytest.mark.parametrize(("count", "agents"), SIZES)
def test_every_package_does_what_its_network_does(count: int, agents: int) -> None:
    """Where this fails, a network has changed: run ``python tools/build_machine_code.py``, commit what it makes."""
    batch = scenes(agents, count)
    with checked_against_networks() as worst:
        for weights in ("closed-loop", "traffic"):
            roll_out(weights, batch)
            value(weights, batch)
            predict(weights, batch)
        predict("traj2traj", batch)
        if agents > 1:
            for kind in COSTS:
                attack(kind, batch)
    assert set(worst) == {name for name in names() if agents > 1 or not name.startswith("attack")}
    assert {name: error for name, error in worst.items() if error > TOLERANCE} == {}


@pytest.mark.parametrize("kind", sorted(COSTS))
def test_a_slope_in_one_package_is_that_of_a_rollout_by_steps(kind: str) -> None:
    at_once, by_steps = attack(kind, scenes(24, 2))
    assert by_steps.abs().max() > 1e-3
    torch.testing.assert_close(at_once, by_steps, atol=1e-4 * float(by_steps.abs().max()), rtol=0.0)
