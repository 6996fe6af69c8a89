"""Slopes of the plain forms, which machine code is made of, against differences in double precision."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from advdiff_sumo.diffusion import attack_costs
from advdiff_sumo.diffusion.attack import plain_objective
from advdiff_sumo.diffusion.attack_costs import COSTS, SeenAttack
from advdiff_sumo.diffusion.attack_slope import AttackOnTensors, tensors_of
from advdiff_sumo.diffusion.bodies import AttackStates, attack_distances
from advdiff_sumo.diffusion.exported_step import StepOnTensors
from advdiff_sumo.diffusion.exported_step import tensors_of as step_tensors
from advdiff_sumo.diffusion.guides import autograd_slope
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.decoder import Decoder, Forced, Rollout, motion_now
from tests.diffusion.test_attack import attackers
from tests.diffusion.test_bodies import STEPS, crowd, futures
from tests.diffusion.test_by_hand import double, made, weighed
from tests.diffusion.test_exported_step import scenes
from tests.diffusion.test_fast import SMALL

__all__ = ["made"]


def latents(count: int) -> Tensor:
    generator = torch.Generator().manual_seed(7)
    return torch.randn(count, 8, SMALL.latent, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("rows", [[2], [5, 1]])
@pytest.mark.parametrize("kind", sorted(COSTS))
def test_an_attack_of_every_kind(
    made: Bundle, kind: str, rows: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What counts instants by how near they are has no slope: it stays what it is at the latents that are tried."""
    objective, kept = plain_objective(kind, attackers(made, rows, compiled=False)), []
    counted = attack_costs._meeting

    def held(e: SeenAttack, within_m: float) -> Tensor:
        kept.append(counted(e, within_m))
        return kept[0]

    monkeypatch.setattr(attack_costs, "_meeting", held)
    objective(latents(1))
    assert torch.autograd.gradcheck(objective, (latents(1).requires_grad_(),), fast_mode=True)
    assert bool(kept) == (kind in {"head-on", "junction"})


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("rows", [[2], [5, 1]])
@pytest.mark.parametrize("kind", sorted(COSTS))
def test_the_form_that_is_one_package_is_the_objective(
    made: Bundle, kind: str, rows: list[int], count: int
) -> None:
    """Value and slope of the roll-out with what is seen worked out beforehand, and of the one step after step."""
    scene = attackers(made, rows, compiled=False)
    plain, form = plain_objective(kind, scene), AttackOnTensors(made.traffic.decoder, scene.natural.steps)
    held = tensors_of(kind, scene)

    def objective(free: Tensor) -> Tensor:
        return -form([free[:, rows]], held)[0].mean(-1)

    torch.testing.assert_close(objective(latents(count)), plain(latents(count)), atol=1e-9, rtol=1e-7)
    mine, wanted = (autograd_slope(one, latents(count)) for one in (objective, plain))
    assert wanted[:, rows].abs().max() > 1e-4
    torch.testing.assert_close(mine, wanted, atol=1e-9, rtol=1e-7)


@pytest.mark.parametrize("edges", [True, False])
@pytest.mark.parametrize("rows", [[2], [4, 1], [1, 2, 3, 4, 5, 6]])
def test_what_attackers_meet(rows: list[int], edges: bool) -> None:
    """With somebody on foot, with edges and without, and where nobody else is there."""
    placed, driven = (
        AttackStates.of(crowd(edges), torch.tensor(rows), futures(1, 7, 1)),
        futures(3, len(rows), 2),
    )

    def meets(xy: Tensor, yaw: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        met = attack_distances(Rollout(xy, yaw, driven.speed, driven.accel, driven.curvature), placed)
        assert met.gap.shape == (3, len(rows), STEPS)
        return met.gap, met.overlap, met.off

    free = driven.xy.requires_grad_(), driven.yaw.requires_grad_()
    assert torch.autograd.gradcheck(meets, free, fast_mode=True)


def decoder_of(networks: Bundle, kind: str) -> Decoder:
    """Return the paper's decoder, or one that looks again at each step, with weights other than nothing."""
    if kind == "open":
        return networks.traffic.decoder
    options = SMALL.model_copy(update={"decoder": "closed-loop", "neighbours": 3})
    decoder, generator = ClosedLoopDecoder(options).double(), torch.Generator().manual_seed(1)
    for weight in decoder.parameters():
        weight.data += 0.1 * torch.randn(weight.shape, generator=generator, dtype=torch.float64)
    return decoder.requires_grad_(False)


def drawn(size: int) -> Tensor:
    """Return numbers (2, 8, *size*)."""
    return torch.randn(2, 8, size, generator=torch.Generator().manual_seed(size), dtype=torch.float64)


@pytest.mark.parametrize("rows", [None, [4, 1]], ids=["everybody", "some"])
@pytest.mark.parametrize("kind", ["open", "closed-loop"])
def test_a_step_by_all_that_it_has_slopes_to(made: Bundle, kind: str, rows: list[int] | None) -> None:
    decoder, batch = decoder_of(made, kind), double(scenes(8))
    picked = torch.arange(8) if rows is None else torch.tensor(rows)
    around = decoder.surroundings(batch, picked)
    others = torch.zeros(decoder.options.decoder_layers, 2, 8, SMALL.message, dtype=torch.float64)
    z, h = (drawn(size)[:, picked] for size in (SMALL.latent, SMALL.hidden))
    free = [decoder.begin(z, h), z, *motion_now(around.own), *motion_now(batch)]
    step, held = StepOnTensors(decoder), [others, *step_tensors(around)]

    def value(*free: Tensor) -> Tensor:
        generator, results = torch.Generator().manual_seed(5), step(free, held)
        weights = [torch.randn(x.shape, generator=generator, dtype=x.dtype) for x in results]
        return torch.stack([(w * x).sum() for w, x in zip(weights, results, strict=True)])

    leaves = [x.detach().clone().requires_grad_() for x in free]
    assert torch.autograd.gradcheck(value, leaves, fast_mode=True, atol=1e-4)


@pytest.mark.parametrize("forced", [False, True], ids=["free", "the target is given"])
@pytest.mark.parametrize("kind", ["open", "closed-loop"])
def test_a_rollout_of_everybody(made: Bundle, kind: str, forced: bool) -> None:
    decoder, batch, h = decoder_of(made, kind), double(scenes(8)), drawn(SMALL.hidden)
    mask = torch.zeros(2, 8, 3, dtype=torch.bool)
    mask[:, 0] = forced
    given = Forced(torch.ones(2, 8, 3, 4, dtype=torch.float64), mask)

    def value(z: Tensor) -> Tensor:
        return weighed(decoder(z, h, batch, 3, given))

    free = drawn(SMALL.latent).requires_grad_()
    assert torch.autograd.gradcheck(value, (free,), fast_mode=True, atol=1e-4, rtol=1e-3)
