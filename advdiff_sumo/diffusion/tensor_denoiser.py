"""The denoiser's prediction on tensors of any device: what does not depend on the noisy sample is worked out first.

The same network as ``models.denoiser``, equal up to rounding. (k_s, k_b) of every AdaGN are
kept for the steps of one ladder, what relative poses and the context say in the coupling once a plan, the
condition's convolution too, and convolutions are matrix products, which for a few dozen vehicles is several times as
fast as the library's convolution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import group_norm, pad, silu

from advdiff_sumo.diffusion.denoiser_weights import (
    kernel_of,
    modulation,
    norms_of,
    residual_blocks,
    split_kernel,
    state_of,
)
from advdiff_sumo.diffusion.sampler import Noise
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.denoiser import STEP_WIDTH, AdaGN, Coupling, Denoiser, ResidualBlock, sinusoidal
from advdiff_sumo.models.model_options import GROUPS


@dataclass(frozen=True)
class _Block:
    """A residual block: kernels (C', 3 C) or (C', C), biases (C', 1), and where its norms' channels lie."""

    norms: tuple[slice, slice]
    first: tuple[Tensor, Tensor]
    second: tuple[Tensor, Tensor]
    past: tuple[Tensor, Tensor] | None


class TensorDenoiser:
    """Noise prediction of one network along one ladder of steps, on the network's device.

    Args:
        denoiser: the trained network.
        steps: the diffusion steps at which it will be asked.
    """

    def __init__(self, denoiser: Denoiser, steps: Iterable[int]) -> None:
        self._net, steps, norms = denoiser, list(steps), norms_of(denoiser)
        self._state = state_of(norms)
        self._blocks = _blocks_of(residual_blocks(denoiser))
        self._into, self._out = _kernel(denoiser.into), _kernel(denoiser.out)
        self._steps = {k: self._step(norms, k) for k in steps}
        self._coupling = _coupling_of(denoiser.coupling, steps) if denoiser.coupling else None

    def _step(self, norms: list[AdaGN], k: int) -> tuple[Tensor, Tensor]:
        """Return k_s and k_b (1, ΣC, 1) of all norms at step *k*."""
        scale, shift = modulation(norms, k, self._into[0].device)
        return scale[None, :, None], shift[None, :, None]

    def condition(self, context: Context) -> Noise:
        """Return ε(x, k) for the scenes of *context*."""
        scenes, agents = context.h.shape[:2]
        with torch.no_grad():
            state_of = self._states(context)
            given = self._net.condition(context.prior.mean).flatten(0, 1)[:, None]
            kernel, offset = self._into
            own, known = split_kernel(kernel, self._net.shape[0])
            about = _convolve((known, offset), _across(given))
        into = own, torch.zeros_like(offset)

        def noise(x: Tensor, k: int) -> Tensor:
            scale, shift = self._steps[k]
            state = state_of(x, k)
            y = _convolve(into, _across(x.flatten(0, 1))) + about
            predicted = self._unet(y, state * scale, state * shift)
            return _across(predicted).reshape(scenes, agents, *x.shape[2:])

        return noise

    def _states(self, context: Context) -> Callable[[Tensor, int], Tensor]:
        """Return h_s (M, ΣC, 1) of all norms as a function of noisy sample and step."""
        weight, bias = self._state
        if self._coupling is None:
            fixed = torch.addmm(bias, context.h.flatten(0, 1), weight)[..., None]
            return lambda _x, _k: fixed
        coupled = self._coupling(context)
        return lambda x, k: torch.addmm(bias, coupled(x, k).flatten(0, 1), weight)[..., None]

    @torch.no_grad()
    def _unet(self, x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
        def block(number: int, y: Tensor) -> Tensor:
            return _residual(self._blocks[number], y, scale, shift)

        first = block(0, x)
        second = block(1, _halved(first))
        third = block(2, _halved(second))
        y = block(3, third)
        y = block(4, torch.cat((_doubled(y), second)))
        y = block(5, torch.cat((_doubled(y), first)))
        norm = self._net.norm
        y = silu(group_norm(_across(y), GROUPS, norm.weight, norm.bias, norm.eps))
        return _convolve(self._out, _across(y))


def _coupling_of(
    layer: Coupling, steps: Iterable[int]
) -> Callable[[Context], Callable[[Tensor, int], Tensor]]:
    """Return *layer* as: context, once a plan → (noisy sample, step) → embeddings (B, A, D)."""
    device = layer.out.weight.device
    with torch.no_grad():
        codes = {k: layer.step(sinusoidal(torch.tensor([k], device=device), STEP_WIDTH)) for k in steps}

    def given(context: Context) -> Callable[[Tensor, int], Tensor]:
        known = layer.known(torch.cat((context.prior.mean, context.h), dim=-1))
        edges = layer.net.prepare(context.relative)

        @torch.no_grad()
        def coupled(x: Tensor, k: int) -> Tensor:
            begin = torch.relu(layer.sample(x.flatten(2)) + known + codes[k])
            out: Tensor = context.h + layer.out(layer.net.mix(begin, edges, context.drawn))
            return out

        return coupled

    return given


def _blocks_of(residual: list[ResidualBlock]) -> list[_Block]:
    begin, blocks = 0, []
    for block in residual:
        spans = []
        for norm in (block.first_norm, block.second_norm):
            spans.append(slice(begin, begin + norm.norm.num_channels))
            begin = spans[-1].stop
        past = _kernel(block.past) if isinstance(block.past, nn.Conv1d) else None
        blocks.append(_Block((spans[0], spans[1]), _kernel(block.first), _kernel(block.second), past))
    return blocks


def _kernel(layer: nn.Module) -> tuple[Tensor, Tensor]:
    """Return a convolution's weights (C', taps · C) and its bias (C', 1)."""
    weight, bias = kernel_of(layer)
    return weight, bias[:, None]


def _across(x: Tensor) -> Tensor:
    """Return (C, M, L) of (M, C, L) or the other way round; maps are kept channels first, for one product each."""
    return x.transpose(0, 1)


def _convolve(kernel: tuple[Tensor, Tensor], x: Tensor) -> Tensor:
    """Return (C', M, L) of *x* (C, M, L): one product of the kernel with each place and its two neighbours."""
    weight, bias = kernel
    wide = pad(x, (1, 1))
    columns = torch.cat((wide[..., :-2], x, wide[..., 2:])).flatten(1)
    return torch.addmm(bias, weight, columns).reshape(-1, *x.shape[1:])


def _residual(block: _Block, x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    y = x
    for span, kernel in zip(block.norms, (block.first, block.second), strict=True):
        normal = group_norm(_across(y), GROUPS)
        y = _convolve(kernel, _across(silu(torch.addcmul(shift[:, span], normal, scale[:, span]))))
    if block.past is None:
        return y + x
    weight, bias = block.past
    return y + torch.addmm(bias, weight, x.flatten(1)).reshape(y.shape)


def _halved(x: Tensor) -> Tensor:
    return 0.5 * (x[..., ::2] + x[..., 1::2])


def _doubled(x: Tensor) -> Tensor:
    return x.repeat_interleave(2, dim=-1)
