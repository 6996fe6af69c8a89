"""What the numbers of a latent, and vehicles that stand, count in the denoiser's loss."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.training.denoiser_stage import loss_weight, noise_loss, schedule_of
from advdiff_sumo.training.presets import DenoiserOptions


@pytest.fixture
def telling(bundle: Bundle) -> Bundle:
    """A posterior N(2, 1) in its first number and N(0, 1) in all others, whatever happened."""
    head = bundle.traffic.posterior.head
    with torch.no_grad():
        head.weight.zero_()
        head.bias.zero_()
        head.bias[0] = 2.0
        head.bias[bundle.options.model.latent :] = 6.0 * math.atanh(2.0 / 6.0)  # of variance 1
    return bundle.frozen()


def weight(bundle: Bundle, batch: SceneBatch, **options: float) -> torch.Tensor:
    return loss_weight(bundle, batch, bundle.traffic.encoder(batch), DenoiserOptions(**options))


def test_numbers_count_by_what_the_posterior_tells_with_them(telling: Bundle, batch: SceneBatch) -> None:
    numbers = telling.options.model.latent
    alike = weight(telling, batch)
    assert alike.shape == (batch.scenes, batch.agents, 1, numbers)
    assert (alike == 1.0).all()
    all_in_one = [float(numbers)] + [0.0] * (numbers - 1)  # 2 nats in the first one, none in the others
    torch.testing.assert_close(weight(telling, batch, information=1.0)[0, 0, 0], torch.tensor(all_in_one))
    half = [0.5 * numbers + 0.5] + [0.5] * (numbers - 1)
    torch.testing.assert_close(weight(telling, batch, information=0.5)[0, 0, 0], torch.tensor(half))


def test_who_stands_counts_more(telling: Bundle, batch: SceneBatch) -> None:
    past = batch.past.clone()
    past[..., -1, 3] = 5.0
    past[0, 0, -1, 3] = 0.1
    counts = weight(telling, replace(batch, past=past), standing=3.0)[..., 0, 0]
    assert counts[0, 0] == 3.0
    assert counts.sum() == counts.numel() + 2.0


def test_the_loss_is_the_weighted_mean(telling: Bundle, batch: SceneBatch) -> None:
    context = telling.traffic.encoder(batch)
    x0 = torch.zeros(batch.scenes, batch.agents, *telling.codec.shape)
    k, schedule = torch.full((batch.scenes,), 10), schedule_of(telling)

    def loss(counts: torch.Tensor | None) -> float:
        generator = torch.Generator().manual_seed(1)
        return float(noise_loss(telling.denoiser, x0, context, batch, schedule, k, generator, counts))

    assert loss(torch.full_like(x0, 2.0)) == pytest.approx(2.0 * loss(None))
    assert loss(torch.zeros_like(x0)) == 0.0
