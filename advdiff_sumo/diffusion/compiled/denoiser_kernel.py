"""The denoiser at run time on the CPU, for tensors."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.compiled.coupling import CompiledCoupling
from advdiff_sumo.diffusion.compiled.kernel import Array, affine, array_of, kernel
from advdiff_sumo.diffusion.compiled.unet import BlockWeights, UNetWeights, predict
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
from advdiff_sumo.models.denoiser import Denoiser, ResidualBlock

_SPAN = 8
"""Vehicles at a time: their maps stay in the processor's second cache."""


@kernel
def modulate(
    h: Array, weight: Array, bias: Array, by: Array, offset: Array, scale: Array, shift: Array
) -> None:
    """Set *scale* and *shift* (M, ΣC) to h_s k_s and h_s k_b for embeddings *h* (M, D)."""
    affine(h, weight, bias, scale)
    for n in range(len(scale)):
        row, to = scale[n], shift[n]
        for c in range(len(row)):
            to[c] = row[c] * offset[c]
            row[c] *= by[c]


class CompiledDenoiser:
    """Noise prediction of one network along one ladder of steps, on the CPU.

    Args:
        denoiser: the trained network; its weights are read when this is made.
        steps: the diffusion steps at which it will be asked.
    """

    def __init__(self, denoiser: Denoiser, steps: Iterable[int]) -> None:
        steps, norms, last = list(steps), norms_of(denoiser), denoiser.norm
        self._condition = denoiser.condition
        weight, bias = kernel_of(denoiser.into)
        into, condition = split_kernel(weight, denoiser.shape[0])
        self._about = condition, bias
        out, out_bias = kernel_of(denoiser.out)
        self._weights = UNetWeights(array_of(into), array_of(out), array_of(out_bias))
        self._blocks = tuple(_block_of(block) for block in residual_blocks(denoiser))
        # the last norm has weights of its own: it stands behind the others as one whose h_s is 1
        state, ones = state_of(norms), torch.ones_like(last.weight)
        none = state[0].new_zeros(len(state[0]), len(ones))
        self._state = array_of(torch.cat((state[0], none), dim=1)), array_of(torch.cat((state[1], ones)))
        modulations = {k: modulation(norms, k, weight.device) for k in steps}
        self._steps = {
            k: (array_of(torch.cat((scale, last.weight))), array_of(torch.cat((shift, last.bias))))
            for k, (scale, shift) in modulations.items()
        }
        self._coupling = CompiledCoupling(denoiser.coupling, steps) if denoiser.coupling else None

    def condition(self, context: Context) -> Noise:
        """Return ε(x, k) for the scenes of *context*."""
        about, states_of = self._given(context), self._states(context)

        def noise(x: Tensor, k: int) -> Tensor:
            sample = array_of(x)
            h = states_of(sample, k)
            rows = h.reshape(-1, h.shape[-1])
            scale = np.empty((len(rows), len(self._state[1])), rows.dtype)
            shift = np.empty_like(scale)
            modulate(rows, *self._state, *self._steps[k], scale, shift)
            flat = sample.reshape(-1, *sample.shape[2:])
            predicted = np.empty_like(flat)
            predict(self._weights, self._blocks, flat, about, scale, shift, _SPAN, predicted)
            return torch.from_numpy(predicted.reshape(sample.shape))

        return noise

    def _given(self, context: Context) -> Array:
        """Return (M, C', L) what the condition and the bias add to the first convolution."""
        weight, bias = self._about
        with torch.no_grad():
            given = self._condition(context.prior.mean).flatten(0, 1)[:, None]
            kernel = weight[:, None]  # (C', 1, 3)
            return array_of(nn.functional.conv1d(given, kernel, bias, padding=1))

    def _states(self, context: Context) -> Callable[[Array, int], Array]:
        """Return the embeddings (B, A, D) that norms are modulated by, of noisy sample and step."""
        if self._coupling is None:
            fixed = array_of(context.h)
            return lambda _x, _k: fixed
        return self._coupling.of(context).states


def _block_of(block: ResidualBlock) -> BlockWeights:
    """Return its weights; the bias of the way past is the second convolution's."""
    first, (second, bias) = kernel_of(block.first), kernel_of(block.second)
    if isinstance(block.past, nn.Conv1d):
        past, offset = kernel_of(block.past)
        second, bias = torch.cat((second, past), dim=1), bias + offset
    return BlockWeights(*(array_of(part) for part in (*first, second, bias)))
