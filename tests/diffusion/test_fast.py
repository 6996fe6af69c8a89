"""The networks' forms for run time give what the plain networks give."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from advdiff_sumo.core.map_view import MAP_PIECES
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.fast_networks import fast_denoiser
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, BundleOptions, new_bundle
from advdiff_sumo.models.model_options import (
    PIECE_FEATURES,
    PIECE_POINTS,
    ModelOptions,
)

PIECES = sum(MAP_PIECES["near"])
SMALL = ModelOptions(hidden=32, latent=8, edge=8, message=16, channels=(8, 16, 24), reward_hidden=16)


def bundle(codec: str = "latent", layers: int = 1, situation: bool = False) -> Bundle:
    sizes = {**SMALL.model_dump(), "denoiser_layers": layers, "denoiser_situation": situation}
    made = new_bundle(BundleOptions.parse({"model": sizes, "codec": codec}))
    generator = torch.Generator().manual_seed(1)
    for module in made.modules().values():
        for weight in module.parameters():  # away from the cautious first weights, some of which are all zero
            weight.data += 0.1 * torch.randn(weight.shape, generator=generator)
    return made.frozen()


def scene(scenes: int = 1, agents: int = 6, seed: int = 0) -> SceneBatch:
    """Return vehicles anywhere within some dozen metres, with some map or other around them."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    past = normal(scenes, agents, 5, 4) * torch.tensor([25.0, 25.0, 2.0, 2.0])
    past[..., 3] = past[..., 3].abs() + 5.0
    there = torch.ones(scenes, agents, dtype=torch.bool)
    return SceneBatch(
        past=past,
        past_valid=there[..., None].expand(-1, -1, 5).clone(),
        size=torch.tensor([4.6, 1.9]).expand(scenes, agents, 2).clone(),
        classes=torch.zeros(scenes, agents, dtype=torch.long),
        present=there,
        moved=there.clone(),
        parked=~there,
        map_xy=20.0 * normal(scenes, agents, PIECES, PIECE_POINTS, 2),
        map_features=normal(scenes, agents, PIECES, PIECE_FEATURES),
        map_valid=torch.ones(scenes, agents, PIECES, dtype=torch.bool),
        future=torch.zeros(scenes, agents, 12, 4),
        future_valid=torch.zeros(scenes, agents, 12, dtype=torch.bool),
    )


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(("layers", "situation"), [(0, False), (1, False), (2, False), (2, True)])
@pytest.mark.parametrize("codec", ["latent", "trajectory"])
def test_the_denoiser_at_every_step_of_a_ladder(
    codec: str, layers: int, situation: bool, compiled: bool
) -> None:
    """For more vehicles than are predicted at a time, some of them on foot."""
    made, batch = bundle(codec, layers, situation), scene(scenes=2, agents=11)
    batch.moved[1, 3:] = False
    context = made.traffic.encoder(batch)
    steps = [100, 75, 50, 25]
    noise = fast_denoiser(made.denoiser, compiled)(context)
    x = torch.randn(2, 11, *made.codec.shape, generator=torch.Generator().manual_seed(3))
    for k in steps:
        torch.testing.assert_close(
            noise(x, k), made.denoiser(x, torch.full((2,), k), context), atol=2e-5, rtol=1e-4
        )


@pytest.mark.parametrize("compiled", [True, False])
def test_the_decoder_on_whole_scenes_with_somebody_absent_and_somebody_on_foot(compiled: bool) -> None:
    made, batch = bundle(), scene(scenes=2)
    batch.present[1, 4:] = False
    batch.moved[1, 4:] = False
    batch.moved[0, 2] = False
    context = made.traffic.encoder(batch)
    z = context.prior.sample(torch.Generator().manual_seed(2))
    wanted = made.traffic.decoder(z, context.h, batch)
    rollout, _ = FastDecoder(made.traffic.decoder, compiled).whole(z, context.h, batch)
    there = batch.present
    for name in ("xy", "yaw", "speed", "accel", "curvature"):
        torch.testing.assert_close(
            getattr(rollout, name)[there], getattr(wanted, name)[there], atol=1e-3, rtol=1e-3
        )


@pytest.mark.parametrize("compiled", [True, False])
def test_some_rows_at_the_latents_of_the_whole_and_their_gradient(compiled: bool) -> None:
    made, batch = bundle(), scene(agents=8)
    context = made.traffic.encoder(batch)
    z, rows = context.prior.mean, torch.tensor([5, 2])
    fast = FastDecoder(made.traffic.decoder, compiled)
    whole, trace = fast.whole(z, context.h, batch, 8)
    own = z[:, rows].clone().requires_grad_()
    some = fast.some(own, context.h, batch, rows, 8, trace)
    torch.testing.assert_close(some.xy, whole.xy[:, rows], atol=1e-4, rtol=1e-4)
    (quick,) = torch.autograd.grad(some.xy.sum(), own)
    every = z.clone().requires_grad_()
    (true,) = torch.autograd.grad(made.traffic.decoder(every, context.h, batch, 8).xy[:, rows].sum(), every)
    # what a changed place changes in the interaction is left out; the direction is nearly the same
    alike = torch.cosine_similarity(quick.flatten(), true[:, rows].flatten(), dim=0)
    assert float(alike) > 0.95


def test_a_trace_for_several_samples_at_once() -> None:
    made, batch = bundle(), scene()
    context = made.traffic.encoder(batch)
    fast, rows = FastDecoder(made.traffic.decoder), torch.tensor([1, 3])
    _, trace = fast.whole(context.prior.mean, context.h, batch, 6)
    drawn = torch.randn(3, 2, SMALL.latent, generator=torch.Generator().manual_seed(0))
    many = fast.some(drawn, context.h.expand(3, -1, -1), batch.repeat(3), rows, 6, trace.repeat(3))
    for k in range(3):
        alone = fast.some(drawn[k : k + 1], context.h, batch, rows, 6, trace)
        np.testing.assert_allclose(many.xy[k], alone.xy[0], atol=1e-4)
