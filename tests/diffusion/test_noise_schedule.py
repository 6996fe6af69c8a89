"""The noise schedule: where it begins and ends, and what it does to data."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from advdiff_sumo.diffusion.noise_schedule import NoiseSchedule

KINDS: tuple[Literal["cosine", "linear"], ...] = ("cosine", "linear")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("steps", [10, 100, 1000])
def test_alpha_falls_from_one_to_almost_nothing(kind: Literal["cosine", "linear"], steps: int) -> None:
    alpha = NoiseSchedule(steps, kind).alpha
    assert alpha.shape == (steps + 1,)
    assert alpha.dtype == torch.float64
    assert alpha[0] == 1.0
    assert bool((alpha.diff() <= 0.0).all())
    assert bool((alpha[: steps // 2].diff() < 0.0).all())
    assert 0.0 < float(alpha[-1]) < 0.01


def test_cosine_by_hand() -> None:
    def f(share: float) -> float:
        return math.cos((share + 0.008) / 1.008 * math.pi / 2) ** 2

    alpha = NoiseSchedule(100, "cosine").alpha
    assert float(alpha[50]) == pytest.approx(f(0.5) / f(0.0), abs=1e-12)
    assert float(alpha[100]) == 1e-4  # not 0: the sampler divides by its root


def test_linear_is_that_of_a_thousand_steps_scaled() -> None:
    long, short = NoiseSchedule(1000, "linear").alpha, NoiseSchedule(100, "linear").alpha
    assert float(long[1]) == pytest.approx(1.0 - 1e-4)
    assert float(long[2]) == pytest.approx((1.0 - 1e-4) * (1.0 - (1e-4 + (0.02 - 1e-4) / 999)))
    assert float(short[1]) == pytest.approx(1.0 - 1e-3)
    assert float(short[50]) == pytest.approx(float(long[500]), rel=0.1)


def test_noisy_by_hand() -> None:
    schedule = NoiseSchedule(100)
    alpha = schedule.alpha
    x0, noise = torch.full((2, 1, 3), 2.0), torch.full((2, 1, 3), -1.0)
    made = schedule.noisy(x0, torch.tensor([30, 0]), noise)
    root, rest = math.sqrt(alpha[30]), math.sqrt(1.0 - alpha[30])
    assert made.dtype == torch.float32
    torch.testing.assert_close(made[0], torch.full((1, 3), 2.0 * root - rest))
    torch.testing.assert_close(made[1], x0[1])  # α⁰ = 1: data


@pytest.mark.parametrize("k", [1, 40, 100])
def test_noisy_keeps_the_variance_of_unit_data(k: int) -> None:
    generator = torch.Generator().manual_seed(0)
    schedule = NoiseSchedule(100)
    x0, noise = torch.randn(2, 40_000, generator=generator, dtype=torch.float64)
    made = schedule.noisy(x0[None], torch.tensor([k]), noise[None])[0]
    assert float(made.var()) == pytest.approx(1.0, abs=0.03)
    covered = float((made * x0).mean())  # cov(xᵏ, x⁰) = √αᵏ
    assert covered == pytest.approx(math.sqrt(schedule.alpha[k]), abs=0.03)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 300), st.data())
def test_ladder_goes_down_to_zero_without_repeats(steps: int, data: st.DataObject) -> None:
    count = data.draw(st.integers(1, steps))
    ladder = NoiseSchedule(steps).ladder(count)
    assert (ladder[0], ladder[-1], len(ladder)) == (steps, 0, count + 1)
    gaps = [a - b for a, b in pairwise(ladder)]
    assert min(gaps) >= 1
    assert max(gaps) - min(gaps) <= 2


@pytest.mark.parametrize(
    ("count", "begin", "ladder"),
    [
        (5, 0.9, [90, 72, 54, 36, 18, 0]),
        (5, 1.0, [100, 80, 60, 40, 20, 0]),
        (2, 0.01, [2, 1, 0]),  # no fewer steps than asked for
    ],
)
def test_ladder_begins_at_a_share_of_the_schedule(count: int, begin: float, ladder: list[int]) -> None:
    assert NoiseSchedule(100).ladder(count, begin) == ladder


@pytest.mark.parametrize("count", [0, -1, 101])
def test_ladder_refuses(count: int) -> None:
    with pytest.raises(ValueError, match=f"{count} sampling steps; the schedule has 100"):
        NoiseSchedule(100).ladder(count)
