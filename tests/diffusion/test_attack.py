"""An attack's gradient by hand, against autograd through the networks on tensors, in double precision."""

from __future__ import annotations

import pytest
import torch

from advdiff_sumo.diffusion.attack_costs import COSTS, Natural
from advdiff_sumo.diffusion.compiled.attack import CompiledAttack
from advdiff_sumo.diffusion.fast_attack import attack_objective
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import direction
from advdiff_sumo.diffusion.tensor_attack import AttackScene, tensor_attack
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.codec import LatentCodec
from tests.diffusion.test_by_hand import double, made
from tests.diffusion.test_fast import SMALL, scene

__all__ = ["made"]


def attackers(networks: Bundle, rows: list[int], compiled: bool) -> AttackScene:
    """Return a dense scene with edges of the road, somebody on foot and somebody absent."""
    batch = double(scene(agents=8))
    batch.past[..., :2].mul_(0.3)
    batch.moved[0, 6], batch.moved[0, 7], batch.present[0, 7] = False, False, False
    batch.map_features[..., 4] = 0.0
    batch.map_features[0, :, 30:, 4] = 1.0
    context = networks.traffic.encoder(batch)
    decoder = FastDecoder(networks.traffic.decoder, compiled)
    natural = Natural(*decoder.whole(context.prior.mean, context.h, batch, 6))
    assert isinstance(networks.codec, LatentCodec)
    return AttackScene(decoder, networks.codec, context, batch, torch.tensor(rows), natural)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("rows", [[2], [5, 1]])
@pytest.mark.parametrize("kind", sorted(COSTS))
def test_the_slope_of_every_kind(made: Bundle, kind: str, rows: list[int], count: int) -> None:
    generator = torch.Generator().manual_seed(7)
    latents = torch.randn(count, 8, SMALL.latent, generator=generator, dtype=torch.float64)
    quick = attack_objective(kind, attackers(made, rows, compiled=True))
    assert isinstance(quick, CompiledAttack)
    free = latents.clone().requires_grad_()
    value = tensor_attack(kind, attackers(made, rows, compiled=False))(free)
    (wanted,) = torch.autograd.grad(value.sum(), free)
    assert wanted[:, rows].abs().max() > 1e-4
    torch.testing.assert_close(quick.slope(latents), wanted, atol=1e-9, rtol=1e-7)
    torch.testing.assert_close(quick(latents), value.detach(), atol=1e-9, rtol=1e-7)


def test_a_direction_takes_the_slope_where_there_is_one() -> None:
    class Asked:
        def __call__(self, latents: torch.Tensor) -> torch.Tensor:
            raise AssertionError

        def slope(self, latents: torch.Tensor) -> torch.Tensor:
            return torch.full_like(latents, 3.0)

    made = direction(Asked(), torch.zeros(1, 2, 4), torch.tensor([0.0, 1.0]))
    torch.testing.assert_close(made[0], torch.tensor([[0.0] * 4, [0.5] * 4]))
