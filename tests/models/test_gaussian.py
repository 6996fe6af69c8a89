"""Diagonal Gaussians against torch.distributions."""

from __future__ import annotations

import pytest
import torch
from torch.distributions import Normal, kl_divergence

from advdiff_sumo.models.context import gaussian_head
from advdiff_sumo.models.gaussian import Gaussian


def two() -> tuple[Gaussian, Gaussian]:
    a, b, c, d = torch.randn(4, 2, 3, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return Gaussian(a, b), Gaussian(c, d)


def normal(gaussian: Gaussian) -> Normal:
    return Normal(gaussian.mean, torch.exp(0.5 * gaussian.logvar))


def test_kl() -> None:
    p, q = two()
    torch.testing.assert_close(p.kl(q), kl_divergence(normal(p), normal(q)))
    torch.testing.assert_close(p.kl(p), torch.zeros_like(p.mean))


def test_kl_by_hand() -> None:
    unit = Gaussian(torch.zeros(2), torch.zeros(2))
    moved = Gaussian(torch.tensor([2.0, 0.0]), torch.zeros(2))
    torch.testing.assert_close(moved.kl(unit), torch.tensor([2.0, 0.0]))  # ½ · 2²


def test_sample_is_repeatable_and_has_gradients() -> None:
    mean, logvar = (
        torch.full((40_000,), 3.0, requires_grad=True),
        torch.full((40_000,), -1.0, requires_grad=True),
    )
    a, b = (Gaussian(mean, logvar).sample(torch.Generator().manual_seed(4)) for _ in range(2))
    assert torch.equal(a, b)
    assert float(a.detach().mean()) == pytest.approx(3.0, abs=0.01)
    assert float(a.detach().var()) == pytest.approx(0.3679, rel=0.03)
    grad_mean, grad_logvar = torch.autograd.grad(a.sum(), (mean, logvar))
    torch.testing.assert_close(grad_mean, torch.ones_like(mean))
    torch.testing.assert_close(grad_logvar, 0.5 * (a - mean).detach())


def test_variances_are_bounded_and_begin_small() -> None:
    raw = torch.tensor([[0.0, 0.0, 0.0, 0.0, 1e4, -1e4]])
    made = gaussian_head(raw)
    torch.testing.assert_close(made.mean, torch.zeros(1, 3))
    torch.testing.assert_close(made.logvar, torch.tensor([[-2.0, 4.0, -8.0]]))
