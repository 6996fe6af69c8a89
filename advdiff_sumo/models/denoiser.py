"""Noise prediction network: a 1-D U-Net over z̃ with z concatenated and AdaGN (Sec. III-B).

The paper's network looks at one vehicle at a time: what two of them draw can then only be made to fit by the
decoder. Here a graph layer tells each vehicle what the others' noisy latents say at this step, so that a scene is
drawn as one; it works through the state embedding of AdaGN and begins as nothing at all.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from advdiff_sumo.models.context import Context
from advdiff_sumo.models.driving_situation import SITUATION_FEATURES
from advdiff_sumo.models.from_nothing import from_nothing
from advdiff_sumo.models.interaction import InteractionNet
from advdiff_sumo.models.model_options import GROUPS, ModelOptions

STEP_WIDTH = 64


def sinusoidal(k: Tensor, width: int) -> Tensor:
    """Return the sinusoidal encoding φ(k) (B, width) of diffusion steps *k* (B,)."""
    half = width // 2
    rates = torch.exp(-math.log(1e4) * torch.arange(half, device=k.device, dtype=torch.float32) / half)
    angle = k.to(torch.float32)[:, None] * rates
    return torch.cat((torch.sin(angle), torch.cos(angle)), dim=-1)


class AdaGN(nn.Module):
    """AdaGN(h, k, f) = h_s (k_s GroupNorm(f) + k_b), with h_s affine in h and (k_s, k_b) = MLP(φ(k)).

    Begins as GroupNorm alone: h_s = k_s = 1 and k_b = 0.
    """

    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(GROUPS, channels, affine=False)
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
        """Return normalised features (M, C, L).

        Args:
            features: (M, C, L) feature maps.
            h: (M, D) state embeddings.
            step: (B, 64) encoded diffusion steps; scene b has M / B rows one after the other.
        """
        step_features = self.step(step).repeat_interleave(len(features) // len(step), dim=0)
        scale, shift = step_features[..., None].chunk(2, dim=1)
        out: Tensor = self.state(h)[..., None] * (scale * self.norm(features) + shift)
        return out


class ResidualBlock(nn.Module):
    """Two convolutions with AdaGN before each, and a way past them."""

    def __init__(self, before: int, after: int, hidden: int) -> None:
        super().__init__()
        self.first_norm = AdaGN(before, hidden)
        self.first = nn.Conv1d(before, after, 3, padding=1)
        self.second_norm = AdaGN(after, hidden)
        self.second = nn.Conv1d(after, after, 3, padding=1)
        self.past = nn.Conv1d(before, after, 1) if before != after else nn.Identity()

    def forward(self, x: Tensor, h: Tensor, step: Tensor) -> Tensor:
        """Return (M, after, L)."""
        y = self.first(nn.functional.silu(self.first_norm(x, h, step)))
        y = self.second(nn.functional.silu(self.second_norm(y, h, step)))
        out: Tensor = self.past(x) + y
        return out


class Coupling(nn.Module):
    """h + W G(z̃ᵏ, k, z, h): the state embedding, and what all vehicles' noisy latents mean for it.

    Args:
        options: sizes.
        numbers: how many numbers of a vehicle are diffused.
    """

    def __init__(self, options: ModelOptions, numbers: int) -> None:
        super().__init__()
        width = options.message
        self.sample = nn.Linear(numbers, width)
        self.known = nn.Linear(options.latent + options.hidden, width)
        self.step = nn.Linear(STEP_WIDTH, width)
        self.net = InteractionNet(width, options, options.denoiser_layers)
        self.out = nn.Linear(width, options.hidden)
        nn.init.zeros_(self.out.weight)
        nn.init.constant_(self.out.bias, 0.0)

    def forward(self, x: Tensor, step: Tensor, context: Context) -> Tensor:
        """Return (B, A, D) for noisy *x* (B, A, C, L) at encoded steps *step* (B, 64)."""
        known = self.known(torch.cat((context.prior.mean, context.h), dim=-1))
        begin = torch.relu(self.sample(x.flatten(2)) + known + self.step(step)[:, None])
        coupled: Tensor = self.out(self.net(begin, context.relative, context.drawn))
        return context.h + coupled


class Denoiser(nn.Module):
    """ε(z̃ᵏ, k, z, h), all vehicles of a scene together.

    Args:
        options: sizes.
        shape: (C, L) of what is diffused: (1, Z) for latents, (C, T) for trajectories; L a multiple of 4.
    """

    def __init__(self, options: ModelOptions, shape: tuple[int, int]) -> None:
        super().__init__()
        self.shape = shape
        channels, length = shape
        full, half, quarter = options.channels
        self.situation = (
            from_nothing(SITUATION_FEATURES, options.message, options.hidden, nn.SiLU)
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
        self.out = nn.Conv1d(full, channels, 3, padding=1)
        nn.init.zeros_(self.out.weight)
        nn.init.constant_(self.out.bias, 0.0)  # type: ignore[arg-type] # a bias is there by default

    def forward(self, x: Tensor, k: Tensor, context: Context) -> Tensor:
        """Return the predicted noise (B, A, C, L).

        Args:
            x: (B, A, C, L) noisy latents or trajectories.
            k: (B,) diffusion steps, 1 … K.
            context: its prior's mean is the condition z, its embeddings are h.
        """
        context = self.informed(context)
        scenes, agents = x.shape[:2]
        step = sinusoidal(k, STEP_WIDTH)
        state = context.h if self.coupling is None else self.coupling(x, step, context)
        condition = self.condition(context.prior.mean).flatten(0, 1)[:, None]
        y = self._unet(torch.cat((x.flatten(0, 1), condition), dim=1), state.flatten(0, 1), step)
        return y.reshape(scenes, agents, *x.shape[2:])

    def informed(self, context: Context) -> Context:
        """Return *context* as this network uses it: with embeddings that know lights, vehicles ahead and limits."""
        if self.situation is None:
            return context
        return replace(context, h=context.h + self.situation(context.situation))

    def _unet(self, x: Tensor, h: Tensor, step: Tensor) -> Tensor:
        first = self.down[0](self.into(x), h, step)
        second = self.down[1](nn.functional.avg_pool1d(first, 2), h, step)
        third = self.down[2](nn.functional.avg_pool1d(second, 2), h, step)
        y = self.middle(third, h, step)
        y = self.up[0](torch.cat((interpolate(y, scale_factor=2.0), second), dim=1), h, step)
        y = self.up[1](torch.cat((interpolate(y, scale_factor=2.0), first), dim=1), h, step)
        out: Tensor = self.out(nn.functional.silu(self.norm(y)))
        return out
