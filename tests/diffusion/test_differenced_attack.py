"""An attack's slope by differences, against autograd through the networks along the same latents."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion import attack_slope
from advdiff_sumo.diffusion.attack import AttackScene, plain_objective
from advdiff_sumo.diffusion.attack_slope import WIDEST, attack_objective, differenced_attack
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import Sloped
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from tests.diffusion.test_attack import attackers
from tests.diffusion.test_by_hand import made
from tests.diffusion.test_fast import SMALL

__all__ = ["made"]


def scene(networks: Bundle, rows: list[int]) -> AttackScene:
    """Return attackers whose last latents are the widest, with a closed-loop decoder that has learned nothing new."""
    given = attackers(networks, rows, compiled=False)
    given.codec.std.copy_(torch.arange(1.0, SMALL.latent + 1.0))
    decoder = ClosedLoopDecoder(SMALL).double()
    decoder.load_state_dict(networks.traffic.decoder.state_dict(), strict=False)
    return replace(given, decoder=FastDecoder(decoder.requires_grad_(False)))


def drawn() -> Tensor:
    """Return latents of two samples."""
    generator = torch.Generator().manual_seed(7)
    return 0.1 * torch.randn(2, 8, SMALL.latent, generator=generator, dtype=torch.float64)


def slopes(objective: Sloped, given: AttackScene, latents: Tensor) -> tuple[Tensor, Tensor]:
    """Return the slope by differences, and that of autograd."""
    free = latents.clone().requires_grad_()
    (wanted,) = torch.autograd.grad(plain_objective("any", given)(free).sum(), free)
    return objective.slope(latents), wanted


def test_it_is_the_gradient_along_the_widest_latents(made: Bundle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attack_slope, "STEP", 1e-5)
    given = scene(made, [2])
    objective = attack_objective("any", given)
    assert isinstance(objective, Sloped)
    slope, wanted = slopes(objective, given, drawn())
    assert wanted[:, 2, -WIDEST:].abs().max() > 1.0
    torch.testing.assert_close(slope[:, 2, -WIDEST:], wanted[:, 2, -WIDEST:], atol=1e-3, rtol=1e-3)
    slope[:, 2, -WIDEST:] = 0.0
    assert not bool(slope.any())  # nobody else, and no other latent


def test_two_attackers_are_tried_at_once_and_each_looks_at_itself(
    made: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(attack_slope, "STEP", 1e-5)
    given, rows = scene(made, [5, 1]), [5, 1]
    slope, wanted = slopes(differenced_attack("any", given), given, drawn())
    for row in rows:
        own, whole = slope[:, row, -WIDEST:].flatten(), wanted[:, row, -WIDEST:].flatten()
        assert float(torch.cosine_similarity(own, whole, dim=0)) > 0.9


def test_its_value_has_gradients(made: Bundle) -> None:
    given = scene(made, [2])
    latents = torch.zeros(1, 8, SMALL.latent, dtype=torch.float64, requires_grad=True)
    value = attack_objective("any", given)(latents)
    torch.testing.assert_close(value, plain_objective("any", given)(latents))
    assert bool(torch.autograd.grad(value.sum(), latents)[0].any())
