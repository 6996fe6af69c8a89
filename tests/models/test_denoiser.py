"""The denoiser's parts against their equations, and what each of its inputs reaches."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from advdiff_sumo.models.context import Context
from advdiff_sumo.models.denoiser import AdaGN, Denoiser, sinusoidal
from advdiff_sumo.models.driving_situation import SITUATION_FEATURES
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.geometry import RELATIVE_FEATURES
from advdiff_sumo.models.model_options import ModelOptions

Stir = Callable[[nn.Module], nn.Module]
SHAPES = ((1, 8), (3, 12))


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def test_sinusoidal_by_hand() -> None:
    """Four numbers: angles k and k / 100 (10⁴ to the power of ½), sines first."""
    made = sinusoidal(torch.tensor([0, 3]), 4)
    wanted = [[0.0, 0.0, 1.0, 1.0], [math.sin(3), math.sin(0.03), math.cos(3), math.cos(0.03)]]
    torch.testing.assert_close(made, torch.tensor(wanted))


def test_sinusoidal_tells_all_steps_apart() -> None:
    made = sinusoidal(torch.arange(1, 101), 64)
    apart = torch.cdist(made, made) + 10.0 * torch.eye(100)
    assert float(apart.min()) > 0.5


def group_norm(f: Tensor, groups: int = 8) -> Tensor:
    """Return GroupNorm of (M, C, L) as its definition says: zero mean and unit variance in each group."""
    split = f.reshape(len(f), groups, -1)
    split = split - split.mean(-1, keepdim=True)
    return (split / torch.sqrt(split.square().mean(-1, keepdim=True) + 1e-5)).reshape(f.shape)


def of_rows(layer: AdaGN, f: Tensor, h: Tensor, step: Tensor) -> Tensor:
    """Return AdaGN of features (M, C, L) and embeddings (M, D), the same number for each of the scenes of *step*."""
    scenes = len(step)
    made: Tensor = layer(f.unflatten(0, (scenes, -1)).permute(2, 0, 1, 3), h.unflatten(0, (scenes, -1)), step)
    return made.permute(1, 2, 0, 3).flatten(0, 1)


def test_adagn_begins_as_group_norm() -> None:
    layer = AdaGN(16, 6)
    last = layer.step[2]
    assert isinstance(last, nn.Linear)
    for linear in (layer.state, last):
        linear.weight.data.zero_()
    f = noise(4, 16, 8)
    torch.testing.assert_close(
        of_rows(layer, f, noise(4, 6), noise(2, 64)), group_norm(f), atol=1e-5, rtol=1e-5
    )


def test_adagn_by_hand() -> None:
    """h_s (k_s GroupNorm(f) + k_b) with h_s = 1 + 2 h₀, k_s = 3 and k_b = −1 + c / 10 in channel c."""
    layer = AdaGN(8, 2)
    last = layer.step[2]
    assert isinstance(last, nn.Linear)
    layer.state.weight.data = torch.tensor([[2.0, 0.0]]).expand(8, 2).clone()
    layer.state.bias.data = torch.ones(8)
    last.weight.data.zero_()
    shift = -1.0 + 0.1 * torch.arange(8.0)
    last.bias.data = torch.cat((torch.full((8,), 3.0), shift))
    f = torch.tensor([1.0, 3.0]).expand(2, 8, 2)  # one channel a group: normalised to −1, 1
    h = torch.tensor([[0.0, 9.0], [0.5, 9.0]])
    made = of_rows(layer, f, h, noise(1, 64))
    wanted = torch.stack((-3.0 + shift, 3.0 + shift), dim=-1)
    torch.testing.assert_close(made, torch.stack((wanted, 2.0 * wanted)), atol=1e-4, rtol=0.0)


def test_adagn_is_its_equation_for_any_weights(lively: Stir) -> None:
    layer = AdaGN(16, 6)
    lively(layer)
    f, h, step = noise(6, 16, 4), noise(6, 6, seed=1), noise(2, 64, seed=2)
    made = of_rows(layer, f, h, step)
    for row in range(6):
        scale, shift = layer.step(step[row // 3]).chunk(2)  # rows 0–2 are scene 0, 3–5 scene 1
        state = layer.state(h[row])[:, None]
        wanted = state * (scale[:, None] * group_norm(f[row : row + 1])[0] + shift[:, None])
        torch.testing.assert_close(made[row], wanted, atol=1e-5, rtol=1e-4)


def inputs(options: ModelOptions, shape: tuple[int, int]) -> tuple[Tensor, Tensor, Context]:
    mean = noise(2, 3, options.latent, seed=1)
    context = Context(
        h=noise(2, 3, options.hidden, seed=2),
        prior=Gaussian(mean, torch.zeros_like(mean)),
        relative=noise(2, 3, 3, RELATIVE_FEATURES, seed=3),
        drawn=torch.ones(2, 3, dtype=torch.bool),
        situation=noise(2, 3, SITUATION_FEATURES, seed=4),
    )
    return noise(2, 3, *shape), torch.tensor([5, 80]), context


def changed(context: Context, name: str, at: tuple[int, int]) -> Context:
    mean, h = context.prior.mean.clone(), context.h.clone()
    {"z": mean, "h": h}[name][at] += 0.5
    return replace(context, h=h, prior=Gaussian(mean, context.prior.logvar))


@pytest.mark.parametrize("shape", SHAPES)
def test_untrained_it_predicts_nothing(options: ModelOptions, shape: tuple[int, int]) -> None:
    made = Denoiser(options, shape)(*inputs(options, shape))
    assert made.shape == (2, 3, *shape)
    assert not bool(made.any())


def reached(net: nn.Module, options: ModelOptions, shape: tuple[int, int], name: str) -> list[list[int]]:
    """Return which (scene, agent) see a change of *name* at agent 1 of scene 0."""
    x, k, context = inputs(options, shape)
    at, base = (0, 1), net(x, k, context)
    if name == "x":
        made = net(x + 0.5 * torch.eye(6)[1].reshape(2, 3, 1, 1), k, context)
    else:
        made = net(x, k, changed(context, name, at))
    found: list[list[int]] = ((made - base).abs().amax((-1, -2)) > 1e-4).nonzero().tolist()
    return found


@pytest.mark.parametrize("name", ["x", "z", "h"])
@pytest.mark.parametrize("shape", SHAPES)
def test_without_coupling_every_input_matters_to_its_agent_alone(
    options: ModelOptions, shape: tuple[int, int], name: str, lively: Stir
) -> None:
    alone = options.model_copy(update={"denoiser_layers": 0})
    assert reached(lively(Denoiser(alone, shape)), alone, shape, name) == [[0, 1]]


@pytest.mark.parametrize("name", ["x", "z", "h"])
@pytest.mark.parametrize("shape", SHAPES)
def test_with_coupling_every_input_matters_to_its_scene_alone(
    options: ModelOptions, shape: tuple[int, int], name: str, lively: Stir
) -> None:
    assert reached(lively(Denoiser(options, shape)), options, shape, name) == [[0, 0], [0, 1], [0, 2]]


def test_who_has_no_latent_tells_nobody_anything(options: ModelOptions, lively: Stir) -> None:
    net = lively(Denoiser(options, SHAPES[0]))
    x, k, context = inputs(options, SHAPES[0])
    context.drawn[0, 1] = False
    other = x.clone()
    other[0, 1] += 1.0
    made, base = net(other, k, context), net(x, k, context)
    torch.testing.assert_close(made[:, [0, 2]], base[:, [0, 2]])


def test_an_untrained_coupling_changes_nothing(options: ModelOptions) -> None:
    x, k, context = inputs(options, SHAPES[0])
    net = Denoiser(options, SHAPES[0])
    assert net.coupling is not None
    made = net.coupling(x, sinusoidal(k, 64), net.prepare(context))
    torch.testing.assert_close(made, context.h)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_step_matters(options: ModelOptions, shape: tuple[int, int], lively: Stir) -> None:
    net = lively(Denoiser(options, shape))
    x, k, context = inputs(options, shape)
    moved = (net(x, torch.tensor([5, 20]), context) - net(x, k, context)).abs().amax((-1, -2)) > 1e-4
    assert moved.tolist() == [[False] * 3, [True] * 3]


@pytest.mark.parametrize("shape", SHAPES)
def test_gradients_reach_every_weight(options: ModelOptions, shape: tuple[int, int], lively: Stir) -> None:
    net = lively(Denoiser(options, shape))
    net(*inputs(options, shape)).square().sum().backward()
    for name, weight in net.named_parameters():
        assert weight.grad is not None, name
        assert bool(torch.isfinite(weight.grad).all()), name
        assert bool(weight.grad.any()), name
