"""Noise prediction network: a 1-D U-Net over z̃ with z concatenated and AdaGN (Sec. III-B).

The paper's network denoises each vehicle on its own, so that only the decoder can make the samples of two vehicles
consistent. Here a graph layer exchanges the noisy latents of all vehicles at each step: a scene is sampled jointly.
Its output, initialised to zero, is added to the state embedding that AdaGN reads.

Feature maps have channels first, (C, B, A, L): a convolution is then one matrix product for all vehicles.
:meth:`Denoiser.prepare` computes, once a plan, what does not depend on the noisy sample.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import group_norm, pad, silu

from advdiff_sumo.models.context import Context
from advdiff_sumo.models.driving_situation import SITUATION_FEATURES
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.models.model_options import GROUPS, ModelOptions
from advdiff_sumo.models.perceptron import zero_initialised, zero_output_perceptron

STEP_WIDTH = 64


def sinusoidal(k: Tensor, width: int) -> Tensor:
    """Return the sinusoidal encoding φ(k) (B, width) of diffusion steps *k* (B,)."""
    half = width // 2
    rates = torch.exp(-math.log(1e4) * torch.arange(half, device=k.device, dtype=torch.float32) / half)
    angle = k.to(torch.float32)[:, None] * rates
    return torch.cat((torch.sin(angle), torch.cos(angle)), dim=-1)


class AdaGN(nn.Module):
    """AdaGN(h, k, f) = h_s (k_s GroupNorm(f) + k_b), with h_s affine in h and (k_s, k_b) = MLP(φ(k)).

    Initialised as plain GroupNorm: h_s = k_s = 1 and k_b = 0.
    """

    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.state = nn.Linear(hidden, channels)
        self.step = nn.Sequential(
            nn.Linear(STEP_WIDTH, STEP_WIDTH), nn.SiLU(), nn.Linear(STEP_WIDTH, 2 * channels)
        )
        last = self.step[-1]
        assert isinstance(last, nn.Linear)  # noqa: S101 - tells the type checker what stands there
        for layer, bias in ((self.state, [1.0]), (last, [1.0, 0.0])):
            nn.init.normal_(layer.weight, std=0.02)
            layer.bias.data = torch.tensor(bias).repeat_interleave(channels)

    def forward(self, features: Tensor, h: Tensor, step: Tensor) -> Tensor:
        """Return *features* (C, B, A, L) normalised, for embeddings *h* (B, A, D) at encoded steps *step* (B, 64)."""
        scale, shift = self.step(step).t()[..., None, None].chunk(2)  # (C, B, 1, 1)
        state = self.state(h).permute(2, 0, 1)[..., None]  # (C, B, A, 1)
        out: Tensor = state * (scale * normalised(features) + shift)
        return out


class ResidualBlock(nn.Module):
    """Two convolutions, each after AdaGN, and a skip connection."""

    def __init__(self, before: int, after: int, hidden: int) -> None:
        super().__init__()
        self.first_norm = AdaGN(before, hidden)
        self.first = nn.Conv1d(before, after, 3, padding=1)
        self.second_norm = AdaGN(after, hidden)
        self.second = nn.Conv1d(after, after, 3, padding=1)
        self.past = nn.Conv1d(before, after, 1) if before != after else nn.Identity()

    def forward(self, x: Tensor, h: Tensor, step: Tensor) -> Tensor:
        """Return (after, B, A, L) for *x* (before, B, A, L), *h* (B, A, D) and *step* (B, 64)."""
        y = convolved(self.first, silu(self.first_norm(x, h, step)))
        y = convolved(self.second, silu(self.second_norm(y, h, step)))
        return (convolved(self.past, x) if isinstance(self.past, nn.Conv1d) else x) + y


class Coupling(nn.Module):
    """h + W G(z̃ᵏ, k, z, h): the state embedding plus messages between all vehicles' noisy latents.

    Args:
        options: sizes.
        numbers: how many numbers are diffused for each vehicle.
    """

    def __init__(self, options: ModelOptions, numbers: int) -> None:
        super().__init__()
        width = options.message
        self.sample = nn.Linear(numbers, width)
        self.known = nn.Linear(options.latent + options.hidden, width)
        self.step = nn.Linear(STEP_WIDTH, width)
        self.net = InteractionNet(width, options, options.denoiser_layers)
        self.out = zero_initialised(nn.Linear(width, options.hidden))

    def prepare(self, context: Context) -> tuple[Tensor, Tensor]:
        """Return embedded conditions (B, A, M) and embedded relative poses (layers, B, A, A, M)."""
        known = self.known(torch.cat((context.prior.mean, context.h), dim=-1))
        return known, torch.stack(self.net.prepare(context.relative))

    def forward(self, x: Tensor, step: Tensor, prepared: Prepared) -> Tensor:
        """Return (B, A, D) for noisy latents or trajectories *x* (B, A, C, L) at encoded steps *step* (B, 64)."""
        begin = torch.relu(self.sample(x.flatten(2)) + prepared.known + self.step(step)[:, None])
        mixed: Tensor = self.out(self.net.mix(begin, list(prepared.edges.unbind(0)), prepared.drawn))
        return prepared.h + mixed


class Prepared(NamedTuple):
    """The part of a noise prediction that does not depend on the noisy sample.

    Attributes:
        h: (B, A, D) state embeddings.
        condition: (B, A, L) the condition z as input of the first convolution.
        known: (B, A, M) embedded conditions, of ``Coupling.prepare``; (B, A, 0) without coupling.
        edges: (layers, B, A, A, M) embedded relative poses.
        drawn: (B, A) whether the agent has a latent.
    """

    h: Tensor
    condition: Tensor
    known: Tensor
    edges: Tensor
    drawn: Tensor


class Denoiser(nn.Module):
    """ε(z̃ᵏ, k, z, h) of all vehicles of a scene jointly.

    Args:
        options: sizes.
        shape: (C, L) of what is diffused: (1, Z) for latents, (C, T) for trajectories; L a multiple of 4.
    """

    def __init__(self, options: ModelOptions, shape: tuple[int, int]) -> None:
        super().__init__()
        self.options, self.shape = options, shape
        channels, length = shape
        full, half, quarter = options.channels
        self.situation = (
            zero_output_perceptron(SITUATION_FEATURES, options.message, options.hidden, nn.SiLU)
            if options.denoiser_situation
            else None
        )
        self.condition = nn.Identity() if length == options.latent else nn.Linear(options.latent, length)
        width = options.hidden
        self.coupling = Coupling(options, channels * length) if options.denoiser_layers else None
        self.into = nn.Conv1d(channels + 1, full, 3, padding=1)
        self.down = nn.ModuleList(
            (
                ResidualBlock(full, full, width),
                ResidualBlock(full, half, width),
                ResidualBlock(half, quarter, width),
            )
        )
        self.middle = ResidualBlock(quarter, quarter, width)
        self.up = nn.ModuleList(
            (ResidualBlock(quarter + half, half, width), ResidualBlock(half + full, full, width))
        )
        self.norm = nn.GroupNorm(GROUPS, full)
        self.out = zero_initialised(nn.Conv1d(full, channels, 3, padding=1))

    def forward(self, x: Tensor, k: Tensor, context: Context) -> Tensor:
        """Return the noise (B, A, C, L) predicted in latents or trajectories *x* (B, A, C, L) at steps *k* (B,), 1 … K.

        The condition z is the mean of the *context*'s prior, h its embeddings.
        """
        return self.predict(x, sinusoidal(k, STEP_WIDTH), self.prepare(context))

    def prepare(self, context: Context) -> Prepared:
        """Return the part of the prediction that depends on neither noisy sample nor step."""
        mean = context.prior.mean
        if self.situation is not None:  # signals, lead vehicles and speed limits
            context = replace(context, h=context.h + self.situation(context.situation))
        known, edges = mean[..., :0], mean[None, :, :, None, :0]
        if self.coupling is not None:
            known, edges = self.coupling.prepare(context)
        return Prepared(context.h, self.condition(mean), known, edges, context.drawn)

    def predict(self, x: Tensor, step: Tensor, prepared: Prepared) -> Tensor:
        """Return the predicted noise (B, A, C, L) of *x* at encoded steps *step* (B, 64)."""
        state = prepared.h if self.coupling is None else self.coupling(x, step, prepared)
        maps = torch.cat((x.permute(2, 0, 1, 3), prepared.condition[None]))
        return self._unet(maps, state, step).permute(1, 2, 0, 3)

    def _unet(self, x: Tensor, h: Tensor, step: Tensor) -> Tensor:
        first = self.down[0](convolved(self.into, x), h, step)
        second = self.down[1](halved(first), h, step)
        third = self.down[2](halved(second), h, step)
        y = self.middle(third, h, step)
        y = self.up[0](torch.cat((y.repeat_interleave(2, dim=-1), second)), h, step)
        y = self.up[1](torch.cat((y.repeat_interleave(2, dim=-1), first)), h, step)
        return convolved(self.out, silu(normalised(y, self.norm)))


def convolved(layer: nn.Conv1d, x: Tensor) -> Tensor:
    """Return length-preserving convolution *layer* of maps *x* (C, B, A, L), computed as one matrix product."""
    weight, reach = layer.weight, layer.kernel_size[0] // 2
    length = x.shape[-1]
    wide = pad(x, (reach, reach))
    columns = torch.cat([wide[..., k : k + length] for k in range(2 * reach + 1)]).flatten(1)
    bias = layer.bias
    assert bias is not None  # noqa: S101 - every layer here has one
    kernel = weight.transpose(1, 2).flatten(1)  # (C', taps · C)
    return torch.addmm(bias[:, None], kernel, columns).reshape(-1, *x.shape[1:])


def normalised(x: Tensor, by: nn.GroupNorm | None = None) -> Tensor:
    """Return GroupNorm of maps *x* (C, B, A, L), with the weights of *by*; None: without weights."""
    rows = x.flatten(1, 2).transpose(0, 1)
    weights = (None, None) if by is None else (by.weight, by.bias)
    return group_norm(rows, GROUPS, *weights).transpose(0, 1).reshape(x.shape)


def halved(x: Tensor) -> Tensor:
    """Return means of neighbouring pairs (…, L / 2)."""
    return 0.5 * (x[..., ::2] + x[..., 1::2])
