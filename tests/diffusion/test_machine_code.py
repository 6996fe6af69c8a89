"""Every package that ships does what the network does, and is not asked about what it is not for."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion.attack import AttackScene, Natural, plain_objective
from advdiff_sumo.diffusion.attack_costs import COSTS
from advdiff_sumo.diffusion.attack_slope import attack_code, sloped_attack
from advdiff_sumo.diffusion.exported_step import exported_step
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.fast_networks import (
    PredictionOnTensors,
    denoiser_package,
    fast_denoiser,
    fast_reward,
)
from advdiff_sumo.diffusion.guides import autograd_slope
from advdiff_sumo.diffusion.machine_code import Fitting, machine_code
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.denoiser import STEP_WIDTH
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.traffic.diffusion.guidance import HORIZON_STEPS, NEAR_STEPS
from tests.diffusion.shipped_code import assert_close, checked_against_networks, names, needs_code
from tests.diffusion.test_exported_step import scenes

pytestmark = needs_code
TRAFFIC = re.compile("decoder-step-d3a|reward-8e4|denoiser-c6d|attack-costs|attack-slope-f31")
"""Packages of the weights "traffic"."""
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
    everybody, some = z.clone().requires_grad_(), (z[:, rows] + 0.5).requires_grad_()
    joint = decoder(weights)(everybody, h, batch, 3)
    alone = decoder(weights).some(some, h, batch, rows, 4, trace)
    for rollout, free in ((joint, everybody), (alone, some)):
        assert bool(torch.autograd.grad(rollout.states().sum(), free)[0].any())


def value(weights: str, batch: SceneBatch) -> None:
    """Work out Q and its slope."""
    reward, sizes = bundle(weights).reward, bundle(weights).options.model
    h, z, mu = drawn(batch, sizes.hidden, sizes.latent, sizes.latent)
    state = reward.prepare(h, z, batch, torch.zeros(batch.scenes, dtype=torch.long))
    autograd_slope(fast_reward(reward)(state), mu)


@torch.no_grad()
def predict(weights: str, batch: SceneBatch) -> None:
    """Predict noise at a step."""
    net = bundle(weights).denoiser
    (x,) = drawn(batch, net.shape[0] * net.shape[1])
    context = bundle(weights).traffic.encoder(batch)
    fast_denoiser(net)(context)(x.reshape(*x.shape[:2], *net.shape), 40)


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
    return sloped_attack(kind, given, code).slope(latents), autograd_slope(
        plain_objective(kind, given), latents
    )


@pytest.mark.parametrize(("count", "agents"), SIZES)
def test_every_package_does_what_its_network_does(count: int, agents: int) -> None:
    """Where this fails, a network has changed: run ``python tools/build_machine_code.py``, commit what it makes."""
    batch = scenes(agents, count)
    with checked_against_networks() as errors:
        for weights in ("closed-loop", "traffic"):
            roll_out(weights, batch)
            value(weights, batch)
            predict(weights, batch)
        predict("traj2traj", batch)
        if agents > 1:
            for kind in COSTS:
                attack(kind, batch)
    assert set(errors) == {name for name in names() if agents > 1 or not name.startswith("attack")}
    assert_close(errors)


@pytest.mark.parametrize("kind", sorted(COSTS))
def test_a_slope_in_one_package_is_that_of_a_rollout_by_steps(kind: str) -> None:
    at_once, by_steps = attack(kind, scenes(24, 2))
    assert by_steps.abs().max() > 1e-3
    torch.testing.assert_close(at_once, by_steps, atol=1e-4 * float(by_steps.abs().max()), rtol=0.0)


@pytest.mark.parametrize("agents", [1, 2, 9])
def test_where_no_road_edge_or_nothing_of_the_map_counts(agents: int) -> None:
    batch = scenes(agents, 1)
    for changed in (batch.map_features[..., 4], batch.map_valid):
        changed.zero_()
        with checked_against_networks() as errors:
            for weights in ("closed-loop", "traffic"):
                roll_out(weights, batch)
            if agents > 1:
                attack("any", batch)
        assert_close(errors, "decoder-step", *["attack-slope", "attack-costs"][: 2 * (agents > 1)])


def test_what_it_is_for_by_hand() -> None:
    fitting = Fitting([("torch.float32", ["B", 2]), ("torch.bool", ["B"])], {"B": (2, 4)})
    for size, fits in ((1, False), (2, True), (4, True), (5, False)):
        assert fitting.holds([torch.zeros(size, 2), torch.zeros(size, dtype=torch.bool)]) == fits
    there = torch.zeros(3, dtype=torch.bool)
    assert fitting.holds([torch.zeros(3, 2), there])
    for other in (torch.zeros(3, 3), torch.zeros(3, 2, 1), torch.zeros(2, 2), torch.zeros(3, 2).double()):
        assert not fitting.holds([other, there])
    assert not fitting.holds([torch.zeros(3, 2), there.float()])
    with pytest.raises(ValueError, match="argument 2"):
        fitting.holds([torch.zeros(3, 2)])


@pytest.mark.parametrize(("count", "uses"), [(4096, True), (4097, False)])
def test_the_most_scenes_and_one_more(count: int, uses: bool) -> None:
    """Beyond what the code is for, the network serves."""
    networks, batch = bundle("traffic"), scenes(1, count)
    with checked_against_networks() as errors:
        value("traffic", batch)
    assert bool(errors) == uses
    assert_close(errors)
    (mu,) = drawn(batch, networks.options.model.latent)
    state = networks.reward.prepare(*drawn(batch, 128, 32), batch, torch.zeros(count, dtype=torch.long))
    torch.testing.assert_close(fast_reward(networks.reward)(state)(mu), networks.reward.value_of(state, mu))


def test_beyond_the_limits_every_network_serves_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if all were for six agents at most: for seven of them nothing is asked of the code, and all is as without."""
    holds, few = Fitting.holds, {"A": (1, 6)}
    monkeypatch.setattr(
        Fitting, "holds", lambda own, given: holds(replace(own, sizes={**own.sizes, **few}), given)
    )
    for agents, uses in ((6, True), (7, False)):
        batch = scenes(agents, 2)
        with checked_against_networks() as errors:
            roll_out("traffic", batch)
            value("traffic", batch)
            predict("traffic", batch)
            at_once, by_steps = attack("any", batch)
        assert set(errors) == ({name for name in names() if TRAFFIC.match(name)} if uses else set())
        torch.testing.assert_close(at_once, by_steps, atol=1e-4 * float(by_steps.abs().max()), rtol=0.0)


def test_the_closed_loop_step_needs_its_neighbours() -> None:
    """Code for thirteen agents and more is not given two; absent ones make up for them, as the rollouts above show."""
    code = exported_step(bundle("closed-loop").traffic.decoder)
    assert code is not None
    assert code.code.fitting.sizes["A"][0] == bundle("closed-loop").options.model.neighbours + 1


def test_gradients_without_a_package_for_slopes_are_the_networks() -> None:
    net = bundle("traffic").denoiser
    batch = scenes(3, 1)
    given = net.prepare(bundle("traffic").traffic.encoder(batch))
    (x,) = (
        part.reshape(1, 3, *net.shape).requires_grad_() for part in drawn(batch, net.shape[0] * net.shape[1])
    )
    step = torch.zeros(1, STEP_WIDTH)
    code = machine_code(denoiser_package(net.options, net.shape), PredictionOnTensors(net))
    assert code is not None
    results = code([x, step], given)[0], net.predict(x, step, given)
    mine, theirs = (torch.autograd.grad(noise.square().sum(), x)[0] for noise in results)
    torch.testing.assert_close(mine, theirs)
