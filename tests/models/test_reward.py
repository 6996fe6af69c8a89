"""Q: what it reads of an action, and what it does not."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import pytest
import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.reward import RewardModel

TARGET = torch.tensor([3, 1])


@pytest.fixture(scope="module")
def model(options: ModelOptions, lively: Callable[[nn.Module], nn.Module]) -> RewardModel:
    torch.manual_seed(1)
    return cast(RewardModel, lively(RewardModel(options)))


def numbers(options: ModelOptions) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(2)
    return (
        torch.randn(2, 5, options.hidden, generator=generator),
        torch.randn(2, 5, options.latent, generator=generator),
        torch.randn(2, 5, options.latent, generator=generator),
    )


def test_the_targets_row_and_absent_agents_have_no_say(
    model: RewardModel, batch: SceneBatch, options: ModelOptions
) -> None:
    h, z, mu = numbers(options)
    mu.requires_grad_()
    value = model(h, z, mu, batch, TARGET)
    assert value.shape == (2,)
    (grad,) = torch.autograd.grad(value.sum(), mu)
    heard = grad.abs().amax(-1) > 0.0
    wanted = batch.present.clone()
    wanted[torch.arange(2), TARGET] = False
    assert heard.tolist() == wanted.tolist()
    other = mu.detach().clone()
    other[~wanted] = 50.0
    torch.testing.assert_close(model(h, z, other, batch, TARGET), value.detach())


def test_what_absent_agents_are_does_not_matter(
    model: RewardModel, batch: SceneBatch, options: ModelOptions
) -> None:
    h, z, mu = numbers(options)
    wanted = model(h, z, mu, batch, TARGET)
    h[~batch.present], z[~batch.present] = 9.0, -9.0
    torch.testing.assert_close(model(h, z, mu, batch, TARGET), wanted)


def test_it_knows_who_the_target_is(model: RewardModel, batch: SceneBatch, options: ModelOptions) -> None:
    h, z, _ = numbers(options)
    values = torch.stack([model(h, z, torch.zeros_like(z), batch, torch.full((2,), row)) for row in range(3)])
    assert float(torch.pdist(values[:, :1].detach()).min()) > 1e-4


def test_scenes_do_not_mix(model: RewardModel, batch: SceneBatch, options: ModelOptions) -> None:
    h, z, mu = numbers(options)
    wanted = model(h, z, mu, batch, TARGET)
    mu[1] += 1.0
    made = model(h, z, mu, batch, TARGET)
    assert (made == wanted).tolist() == [True, False]


def test_a_prepared_state_serves_many_actions(
    model: RewardModel, batch: SceneBatch, options: ModelOptions
) -> None:
    h, z, mu = numbers(options)
    state = model.prepare(h, z, batch, TARGET)
    for action in (mu, 2.0 * mu):
        torch.testing.assert_close(model.value_of(state, action), model(h, z, action, batch, TARGET))


def test_gradient_of_the_action_against_differences(
    model: RewardModel, batch: SceneBatch, options: ModelOptions
) -> None:
    h, z, mu = numbers(options)
    double = RewardModel(options).double()
    double.load_state_dict(model.state_dict())
    wide = SceneBatch(**{n: v.double() if v.is_floating_point() else v for n, v in vars(batch).items()})
    state = double.prepare(h.double(), z.double(), wide, TARGET)
    action = mu.double().requires_grad_()
    assert torch.autograd.gradcheck(lambda a: double.value_of(state, a), (action,), fast_mode=True)
