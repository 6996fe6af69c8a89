"""An attack's objective by machine code and by the networks: the same values and slopes, for every kind."""

from __future__ import annotations

import pytest
import torch

from advdiff_sumo.diffusion.attack import AttackScene, Natural, plain_objective
from advdiff_sumo.diffusion.attack_costs import COSTS
from advdiff_sumo.diffusion.attack_slope import attack_objective
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import Sloped, autograd_slope, direction
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.shipped_weights import shipped_weights
from tests.diffusion.shipped_code import assert_close, checked_against_networks, needs_code
from tests.diffusion.test_by_hand import double
from tests.diffusion.test_fast import scene


def dense() -> SceneBatch:
    """Return a dense scene with edges of the road, somebody on foot and somebody absent."""
    batch = scene(agents=8)
    batch.past[..., :2].mul_(0.3)
    batch.moved[0, 6], batch.moved[0, 7], batch.present[0, 7] = False, False, False
    batch.map_features[..., 4] = 0.0
    batch.map_features[0, :, 30:, 4] = 1.0
    return batch


def attackers(networks: Bundle, rows: list[int], compiled: bool) -> AttackScene:
    """Return attackers in the dense scene, in the precision of *networks*."""
    batch = dense()
    if networks.traffic.decoder.start.weight.dtype == torch.float64:
        batch = double(batch)
    with torch.no_grad():
        context = networks.traffic.encoder(batch)
    decoder = FastDecoder(networks.traffic.decoder, compiled)
    natural = Natural(*decoder.whole(context.prior.mean, context.h, batch, 6))
    assert isinstance(networks.codec, LatentCodec)
    return AttackScene(decoder, networks.codec, context, batch, torch.tensor(rows), natural)


@needs_code
@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("rows", [[2], [5, 1]])
@pytest.mark.parametrize("kind", sorted(COSTS))
def test_machine_code_has_the_slope_of_every_kind(kind: str, rows: list[int], count: int) -> None:
    """By one package for all, and by packages for steps and costs."""
    networks = load_bundle(shipped_weights("traffic")).frozen()
    generator = torch.Generator().manual_seed(7)
    latents = torch.randn(count, 8, networks.options.model.latent, generator=generator)
    with checked_against_networks() as errors:
        by_code = attackers(networks, rows, compiled=True)
        objective, steps = attack_objective(kind, by_code), plain_objective(kind, by_code)
        assert isinstance(objective, Sloped)
        slope, value = objective.slope(latents), objective(latents)
        slope_of_steps = autograd_slope(steps, latents)
    assert_close(errors, "attack-slope", "attack-costs", "decoder-step")
    plain = plain_objective(kind, attackers(networks, rows, compiled=False), compiled=False)
    wanted = autograd_slope(plain, latents)
    largest = float(wanted.abs().max())
    assert largest > 1e-4
    torch.testing.assert_close(value, plain(latents), atol=1e-5, rtol=1e-5)
    for made in (slope, slope_of_steps):
        torch.testing.assert_close(made, wanted, atol=1e-5 * largest, rtol=0.0)


def test_a_direction_takes_the_slope_where_there_is_one() -> None:
    def value(latents: torch.Tensor) -> torch.Tensor:
        raise AssertionError

    asked = Sloped(value, lambda latents: torch.full_like(latents, 3.0))
    made = direction(asked, torch.zeros(1, 2, 4), torch.tensor([0.0, 1.0]))
    torch.testing.assert_close(made[0], torch.tensor([[0.0] * 4, [0.5] * 4]))
