"""The denoiser's weights in the order in which the run-time forms multiply by them."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn

from advdiff_sumo.models.denoiser import STEP_WIDTH, AdaGN, Denoiser, ResidualBlock, sinusoidal


def residual_blocks(denoiser: Denoiser) -> list[ResidualBlock]:
    """Return the blocks in the order in which they are gone through."""
    blocks = [*denoiser.down, denoiser.middle, *denoiser.up]
    return [block for block in blocks if isinstance(block, ResidualBlock)]


def norms_of(denoiser: Denoiser) -> list[AdaGN]:
    """Return the norms in the order in which they are gone through, with ΣC channels in all."""
    blocks = residual_blocks(denoiser)
    return [norm for block in blocks for norm in (block.first_norm, block.second_norm)]


def state_of(norms: Iterable[AdaGN]) -> tuple[Tensor, Tensor]:
    """Return weight (D, ΣC) and bias (ΣC,) that give h_s of every norm at once."""
    layers = [norm.state for norm in norms]
    weight = torch.cat([layer.weight for layer in layers]).t().contiguous()
    return weight.detach(), torch.cat([layer.bias for layer in layers]).detach()


def modulation(norms: Iterable[AdaGN], k: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return k_s and k_b (ΣC,) of all *norms* at step *k*."""
    code = sinusoidal(torch.tensor([k], device=device), STEP_WIDTH)
    with torch.no_grad():
        chunks = [norm.step(code)[0].chunk(2) for norm in norms]
    scale, shift = (torch.cat(part) for part in zip(*chunks, strict=True))
    return scale, shift


def kernel_of(layer: nn.Module) -> tuple[Tensor, Tensor]:
    """Return a convolution's weights as (C', taps · C), tap by tap, and its bias (C',)."""
    assert isinstance(layer, nn.Conv1d)  # noqa: S101 - tells the type checker what stands there
    assert layer.bias is not None  # noqa: S101 - and that every layer here has one
    return layer.weight.detach().transpose(1, 2).flatten(1).contiguous(), layer.bias.detach()


def split_kernel(weight: Tensor, channels: int) -> tuple[Tensor, Tensor]:
    """Return the parts of a kernel (C', 3 C) that read the first *channels* of its input, and the others."""
    wide = weight.reshape(len(weight), 3, -1)
    return wide[:, :, :channels].flatten(1).contiguous(), wide[:, :, channels:].flatten(1).contiguous()
