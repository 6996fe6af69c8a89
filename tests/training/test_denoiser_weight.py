"""What the numbers of a latent, and vehicles that stand, count in the denoiser's loss."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.training.denoiser_stage import (
    DenoiserStage,
    loss_weight,
    noise_loss,
    sample_score,
    schedule_of,
)
from advdiff_sumo.training.presets import DenoiserOptions
from advdiff_sumo.training.stage import Moment


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


def test_the_score_of_samples_is_least_for_the_data_s_own_distribution(
    telling: Bundle, batch: SceneBatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Data are −1 or 1 by turns; drawn as they are, always −1, and always between."""
    context = telling.traffic.encoder(batch)
    signs = torch.tensor([-1.0, 1.0])[torch.arange(batch.scenes) % 2].reshape(-1, 1, 1, 1)
    x0 = signs.expand(-1, batch.agents, *telling.codec.shape)

    def score(first: float, second: float) -> float:
        drawn = (
            torch.tensor([first, second]).repeat(batch.scenes).reshape(-1, 1, 1, 1).expand(-1, *x0.shape[1:])
        )
        monkeypatch.setattr("advdiff_sumo.training.denoiser_stage.sample", lambda *_: drawn)
        chance = torch.Generator().manual_seed(0)
        return float(sample_score(telling, x0, context, batch, 5, chance, torch.ones_like(x0)))

    assert batch.scenes % 2 == 0
    as_data = 0.25 * (score(-1, -1) + score(1, 1) + score(-1, 1) + score(1, -1))
    assert as_data == pytest.approx(0.5, abs=0.1)  # fewer vehicles in some scenes than in others
    assert score(0.0, 0.0) == pytest.approx(1.0)
    assert score(-1.0, -1.0) > as_data + 0.3


def test_the_score_reaches_the_denoiser_through_all_its_steps(bundle: Bundle, batch: SceneBatch) -> None:
    stage = DenoiserStage(bundle, DenoiserOptions(samples=1.0, sampling_steps=3))
    terms = stage.loss(batch, Moment(0, 1, torch.Generator().manual_seed(0)))
    loss, noise, score = (float(terms[name].detach()) for name in ("loss", "noise", "score"))
    assert loss == pytest.approx(noise + score)
    terms["score"].backward()
    assert bundle.denoiser.out.weight.grad is not None
    assert bundle.denoiser.out.weight.grad.any()
    assert all(p.grad is None for p in bundle.traffic.parameters())
