"""An attack's objective by machine code and by the networks: the same values and slopes, for every kind."""

from __future__ import annotations

import pytest
import torch

from advdiff_sumo.diffusion.attack import AttackScene, Natural, costs_package, plain_objective
from advdiff_sumo.diffusion.attack_costs import COSTS
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import direction
from advdiff_sumo.diffusion.machine_code import runs_here
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.shipped_weights import shipped_weights
from tests.diffusion.test_by_hand import double, made
from tests.diffusion.test_fast import SMALL, scene

__all__ = ["made"]


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
    context = networks.traffic.encoder(batch)
    decoder = FastDecoder(networks.traffic.decoder, compiled)
    natural = Natural(*decoder.whole(context.prior.mean, context.h, batch, 6))
    assert isinstance(networks.codec, LatentCodec)
    return AttackScene(decoder, networks.codec, context, batch, torch.tensor(rows), natural)


@pytest.mark.skipif(not runs_here(costs_package()), reason="no machine code for this PyTorch and processor")
@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("rows", [[2], [5, 1]])
@pytest.mark.parametrize("kind", sorted(COSTS))
def test_machine_code_has_the_slope_of_every_kind(kind: str, rows: list[int], count: int) -> None:
    networks = load_bundle(shipped_weights("traffic")).frozen()
    generator = torch.Generator().manual_seed(7)
    latents = torch.randn(count, 8, networks.options.model.latent, generator=generator)
    results = []
    for compiled in (True, False):
        free = latents.clone().requires_grad_()
        value = plain_objective(kind, attackers(networks, rows, compiled), compiled)(free)
        results.append((value.detach(), torch.autograd.grad(value.sum(), free)[0]))
    (value, slope), (wanted_value, wanted) = results
    assert wanted[:, rows].abs().max() > 1e-4
    torch.testing.assert_close(value, wanted_value, atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(slope, wanted, atol=2e-3 * float(wanted.abs().max()), rtol=1e-2)


@pytest.mark.parametrize("rows", [[2], [5, 1]])
@pytest.mark.parametrize("kind", sorted(set(COSTS) - {"head-on", "junction"}))  # those hold a weight back
def test_the_slope_against_differences(made: Bundle, kind: str, rows: list[int]) -> None:
    generator = torch.Generator().manual_seed(7)
    latents = torch.randn(1, 8, SMALL.latent, generator=generator, dtype=torch.float64)
    objective = plain_objective(kind, attackers(made, rows, compiled=False))
    assert torch.autograd.gradcheck(
        objective, (latents.requires_grad_(),), fast_mode=True, atol=1e-4, rtol=1e-3
    )


def test_a_direction_takes_the_slope_where_there_is_one() -> None:
    class Asked:
        def __call__(self, latents: torch.Tensor) -> torch.Tensor:
            raise AssertionError

        def slope(self, latents: torch.Tensor) -> torch.Tensor:
            return torch.full_like(latents, 3.0)

    made = direction(Asked(), torch.zeros(1, 2, 4), torch.tensor([0.0, 1.0]))
    torch.testing.assert_close(made[0], torch.tensor([[0.0] * 4, [0.5] * 4]))
