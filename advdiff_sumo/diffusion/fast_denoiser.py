"""The denoiser for run time: the same network as ``models.denoiser``, equal up to rounding.

What does not depend on the noisy sample is worked out beforehand. On the CPU the rest is done by ``compiled``,
elsewhere by ``tensor_denoiser``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import torch

from advdiff_sumo.diffusion.sampler import Noise
from advdiff_sumo.diffusion.tensor_denoiser import TensorDenoiser
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.denoiser import Denoiser

if TYPE_CHECKING:
    from advdiff_sumo.diffusion.compiled.denoiser_kernel import CompiledDenoiser


class FastDenoiser:
    """Noise prediction of one network along one ladder of steps.

    Args:
        denoiser: the trained network; its weights are read when this is made.
        steps: the diffusion steps at which it will be asked.
        compiled: predict by compiled loops; None: where the network is on the CPU.
    """

    def __init__(self, denoiser: Denoiser, steps: Iterable[int], compiled: bool | None = None) -> None:
        self._net = denoiser
        here = denoiser.into.weight.device.type == "cpu" if compiled is None else compiled
        self._predicts = _compiled(denoiser, steps) if here else TensorDenoiser(denoiser, steps)

    def condition(self, context: Context) -> Noise:
        """Return ε(x, k) for the scenes of *context*, without gradients."""
        with torch.no_grad():
            informed = self._net.informed(context)
        return self._predicts.condition(informed)


def _compiled(denoiser: Denoiser, steps: Iterable[int]) -> CompiledDenoiser:
    """Return the compiled form; who never asks for it does not wait for the compiler's import."""
    from advdiff_sumo.diffusion.compiled.denoiser_kernel import CompiledDenoiser

    return CompiledDenoiser(denoiser, steps)
