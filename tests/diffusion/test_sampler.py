"""DDIM: Eq. (2) as printed, the consistent family, and samples with a noise that is known exactly."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from advdiff_sumo.diffusion.noise_schedule import NoiseSchedule
from advdiff_sumo.diffusion.sampler import (
    Family,
    Noise,
    Sampling,
    SamplingStep,
    draw,
    predict_at_step,
    sample,
    transition,
)

SCHEDULE = NoiseSchedule(100)
FAMILIES: tuple[Family, ...] = ("printed", "consistent")


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def oracle(x0: Tensor, schedule: NoiseSchedule = SCHEDULE) -> Noise:
    """Return the noise that *x0* must have been given to become x."""

    def noise_of(x: Tensor, k: int) -> Tensor:
        alpha = float(schedule.alpha[k])
        return (x - math.sqrt(alpha) * x0) / math.sqrt(1.0 - alpha)

    return noise_of


def pair(seed: int = 1) -> tuple[Tensor, Tensor]:
    x, noise = torch.randn(2, 2, 3, 1, 8, generator=seeded(seed), dtype=torch.float64)
    return x, noise


@pytest.mark.parametrize("k", [1, 2, 50, 100])
def test_printed_is_equation_two(k: int) -> None:
    """μ = √α^{k−1} (z̃ᵏ − √(1−αᵏ) ε)/√αᵏ + √(1−α^{k−1}) ε, Σ = (1−α^{k−1})/(1−αᵏ) βᵏ."""
    x, noise = pair()
    mean, deviation = transition(x, noise, k, k - 1, SCHEDULE, Sampling(family="printed", clip=0.0))
    now, before = float(SCHEDULE.alpha[k]), float(SCHEDULE.alpha[k - 1])
    beta = 1.0 - now / before  # αᵏ = Π (1 − βˢ)
    first = math.sqrt(before) * ((x - math.sqrt(1.0 - now) * noise) / math.sqrt(now))
    torch.testing.assert_close(mean, first + math.sqrt(1.0 - before) * noise, rtol=1e-10, atol=1e-10)
    assert deviation**2 == pytest.approx((1.0 - before) / (1.0 - now) * beta, abs=1e-12)


def test_printed_takes_no_notice_of_eta() -> None:
    x, noise = pair()
    made = [transition(x, noise, 60, 50, SCHEDULE, Sampling(family="printed", eta=e)) for e in (0.0, 1.0)]
    torch.testing.assert_close(made[0][0], made[1][0])
    assert made[0][1] == made[1][1] > 0.0


def test_a_step_by_hand() -> None:
    """α of 0.64 and 0.84: Σ = 0.16/0.36 · (1 − 0.64/0.84) = 0.105820…; x = 1, ε = 0.5: x̂⁰ = 0.875."""
    schedule = NoiseSchedule(2)
    schedule.__dict__["alpha"] = torch.tensor([1.0, 0.84, 0.64], dtype=torch.float64)
    x, noise = torch.ones(1, dtype=torch.float64), torch.full((1,), 0.5, dtype=torch.float64)
    variance = 0.16 / 0.36 * 0.20 / 0.84
    for sampling, rest in (
        (Sampling(family="printed"), 0.16),
        (Sampling(family="consistent", eta=1.0), 0.16 - variance),
        (Sampling(family="consistent", eta=0.5), 0.16 - 0.25 * variance),
        (Sampling(family="consistent", eta=0.0), 0.16),
    ):
        mean, deviation = transition(x, noise, 2, 1, schedule, sampling)
        assert float(mean) == pytest.approx(math.sqrt(0.84) * 0.875 + math.sqrt(rest) * 0.5, abs=1e-12)
        eta = 1.0 if sampling.family == "printed" else sampling.eta
        assert deviation == pytest.approx(eta * math.sqrt(variance), abs=1e-12)


@pytest.mark.parametrize(("k", "to"), [(1, 0), (2, 1), (100, 90), (70, 35)])
def test_consistent_with_eta_one_is_the_ddpm_posterior(k: int, to: int) -> None:
    """q(x^to | x^k, x⁰): mean √α^to β/(1−α^k) x⁰ + √(α^k/α^to) (1−α^to)/(1−α^k) x^k (Ho et al. 2020, Eq. 7)."""
    x, noise = pair()
    mean, deviation = transition(x, noise, k, to, SCHEDULE, Sampling(eta=1.0, clip=0.0))
    now, then = float(SCHEDULE.alpha[k]), float(SCHEDULE.alpha[to])
    beta = 1.0 - now / then
    x0 = (x - math.sqrt(1.0 - now) * noise) / math.sqrt(now)
    wanted = math.sqrt(then) * beta / (1.0 - now) * x0
    wanted = wanted + math.sqrt(now / then) * (1.0 - then) / (1.0 - now) * x
    torch.testing.assert_close(mean, wanted, rtol=1e-9, atol=1e-9)
    assert deviation**2 == pytest.approx((1.0 - then) / (1.0 - now) * beta, abs=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 1.0), st.integers(1, 100), st.data())
def test_consistent_steps_keep_the_marginal(eta: float, k: int, data: st.DataObject) -> None:
    """With the true noise, x^to has mean √α^to x⁰ and variance 1 − α^to over ε and the new noise, for every η."""
    to = data.draw(st.integers(0, k - 1))
    then = float(SCHEDULE.alpha[to])
    x0, one = torch.tensor([0.7], dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    steps = Sampling(eta=eta, clip=0.0)
    at_rest, deviation = transition(
        SCHEDULE.noisy(x0, torch.tensor([k]), 0.0 * one), 0.0 * one, k, to, SCHEDULE, steps
    )
    shifted, _ = transition(SCHEDULE.noisy(x0, torch.tensor([k]), one), one, k, to, SCHEDULE, steps)
    assert float(at_rest) == pytest.approx(math.sqrt(then) * 0.7, abs=1e-9)
    assert float(shifted - at_rest) ** 2 + deviation**2 == pytest.approx(1.0 - then, abs=1e-9)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_last_step_returns_the_predicted_data(family: Family) -> None:
    x, noise = pair()
    mean, deviation = transition(x, noise, 10, 0, SCHEDULE, Sampling(family=family, clip=0.0))
    alpha = float(SCHEDULE.alpha[10])
    torch.testing.assert_close(mean, (x - math.sqrt(1.0 - alpha) * noise) / math.sqrt(alpha))
    assert deviation == 0.0


def test_clip_bounds_the_data_and_keeps_x_explained() -> None:
    x, noise = torch.tensor([9.0, 0.1], dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    for k, to in ((50, 0), (50, 40)):
        mean, _ = transition(x, noise, k, to, SCHEDULE, Sampling(eta=0.0, clip=2.0))
        now, then = float(SCHEDULE.alpha[k]), float(SCHEDULE.alpha[to])
        left = (9.0 - math.sqrt(now) * 2.0) / math.sqrt(1.0 - now)  # the rest of x must be noise then
        assert float(mean[0]) == pytest.approx(math.sqrt(then) * 2.0 + math.sqrt(1.0 - then) * left)
        free, _ = transition(x, noise, k, to, SCHEDULE, Sampling(eta=0.0, clip=0.0))
        assert float(mean[1]) == pytest.approx(float(free[1]))


@pytest.mark.parametrize("steps", [1, 3, 10, 100])
@pytest.mark.parametrize("kind", ["cosine", "linear"])
def test_an_oracle_is_followed_to_the_data(steps: int, kind: str) -> None:
    schedule = NoiseSchedule(100, "cosine" if kind == "cosine" else "linear")
    x0 = torch.randn(2, 3, 1, 8, generator=seeded(), dtype=torch.float64).clamp(-3.5, 3.5)
    start = torch.randn(x0.shape, generator=seeded(1), dtype=torch.float64)
    made = sample(oracle(x0, schedule), start, schedule, Sampling(steps=steps, eta=0.0), seeded())
    torch.testing.assert_close(made, x0, rtol=0.0, atol=1e-9)


def test_eta_zero_draws_nothing_and_eta_one_does() -> None:
    start = torch.randn(1, 2, 1, 8, generator=seeded(1))

    def half(x: Tensor, k: int) -> Tensor:
        return 0.5 * x

    for sampling, same in (
        (Sampling(eta=0.0), True),
        (Sampling(eta=1.0), False),
        (Sampling(family="printed"), False),
    ):
        a, b, again = (sample(half, start, SCHEDULE, sampling, seeded(s)) for s in (1, 2, 1))
        assert torch.equal(a, again)
        assert torch.equal(a, b) is same


@pytest.mark.parametrize("eta", [0.0, 0.5, 1.0])
def test_gaussian_data_is_sampled_with_its_variance(eta: float) -> None:
    """For data N(0, s²) the best noise prediction is √(1−α) x / (α s² + 1 − α); the sampler must give s back."""
    s = 0.6

    def noise_of(x: Tensor, k: int) -> Tensor:
        alpha = float(SCHEDULE.alpha[k])
        return math.sqrt(1.0 - alpha) * x / (alpha * s**2 + 1.0 - alpha)

    start = torch.randn(1, 20_000, 1, 1, generator=seeded(), dtype=torch.float64)
    made = sample(noise_of, start, SCHEDULE, Sampling(steps=100, eta=eta, clip=0.0), seeded(2))
    assert float(made.std()) == pytest.approx(s, rel=0.03)
    assert abs(float(made.mean())) < 0.02


@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_the_guide_is_added_to_each_mean_and_told_where_it_is(eta: float) -> None:
    """Σ of Eq. (2) is what it is told for every η; with η = 0 nothing is drawn, yet the guide keeps its scale."""
    x0 = torch.zeros(1, 2, 1, 4, dtype=torch.float64)
    seen: list[SamplingStep] = []

    def guide(mean: Tensor, rung: SamplingStep) -> Tensor:
        seen.append(rung)
        return torch.full_like(mean, rung.deviation**2)

    sampling = Sampling(steps=4, eta=eta)
    start = torch.ones_like(x0)
    made = sample(oracle(x0), start, SCHEDULE, sampling, seeded(5), guide)
    generator, x = seeded(5), start
    for rung, (k, to) in zip(seen, pairwise(SCHEDULE.ladder(4)), strict=True):
        now, then = float(SCHEDULE.alpha[k]), float(SCHEDULE.alpha[to])
        sigma = (1.0 - then) / (1.0 - now) * (1.0 - now / then)
        assert rung.alpha == then
        assert rung.deviation**2 == pytest.approx(sigma, abs=1e-12)
        mean, deviation = transition(x, oracle(x0)(x, k), k, to, SCHEDULE, sampling)
        assert deviation == pytest.approx(eta * rung.deviation)
        x = mean + sigma + (deviation * draw(mean, generator) if to and eta else 0.0)
    torch.testing.assert_close(made, x)
    assert [rung.left for rung in seen] == [3, 2, 1, 0]
    assert seen[-1].deviation == 0.0


def test_a_constant_push_moves_samples_its_way() -> None:
    start = torch.randn(1, 2000, 1, 1, generator=seeded(), dtype=torch.float64)

    def noise_of(x: Tensor, k: int) -> Tensor:  # of data N(0, 1)
        return math.sqrt(1.0 - float(SCHEDULE.alpha[k])) * x

    shifts = []
    for strength in (-0.5, 0.0, 0.5, 1.0):
        made = sample(
            noise_of,
            start,
            SCHEDULE,
            Sampling(),
            seeded(1),
            lambda mean, rung, g=strength: g * rung.deviation**2 * torch.ones_like(mean),  # type: ignore[misc] # bound now
        )
        shifts.append(float(made.mean()))
    assert shifts == sorted(shifts)
    assert shifts[0] < -0.1 < 0.1 < shifts[2]


@pytest.mark.parametrize("done", range(4))
def test_foresight_of_a_network_that_knows_is_the_data(done: int) -> None:
    x0 = torch.randn(2, 3, 1, 8, generator=seeded(2))
    start = torch.randn(2, 3, 1, 8, generator=seeded(3))
    made = predict_at_step(oracle(x0), start, SCHEDULE, Sampling(steps=4), seeded(), done)
    torch.testing.assert_close(made.clean, x0, atol=2e-4, rtol=1e-3)
    torch.testing.assert_close(made.noise, oracle(x0)(made.x, made.k))
    assert (made.k, made.alpha) == (100 - 25 * done, float(SCHEDULE.alpha[100 - 25 * done]))


def test_foresight_has_a_gradient_in_its_last_prediction_alone() -> None:
    asked: list[tuple[int, bool]] = []
    weight = torch.ones((), requires_grad=True)

    def noise_of(x: Tensor, k: int) -> Tensor:
        asked.append((k, torch.is_grad_enabled()))
        return weight * x

    made = predict_at_step(noise_of, torch.ones(1, 1, 1, 4), SCHEDULE, Sampling(steps=4), seeded(), 2)
    made.clean.sum().backward()
    assert asked == [(100, False), (75, False), (50, True)]
    assert weight.grad is not None
    assert float(weight.grad) != 0.0
