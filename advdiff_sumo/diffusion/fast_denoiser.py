"""The denoiser for run time: ``Denoiser.predict``, on a CPU by machine code that is made of it.

What does not depend on the noisy sample is worked out beforehand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.machine_code import machine_code, package_for
from advdiff_sumo.diffusion.sampler import Noise
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.denoiser import STEP_WIDTH, Denoiser, Prepared, sinusoidal
from advdiff_sumo.models.model_options import ModelOptions

_SIZES = ("hidden", "latent", "edge", "message", "heads", "channels", "denoiser_layers")
"""Options that the code of a denoiser depends on."""


class PredictionOnTensors(nn.Module):
    """``Denoiser.predict`` with tensors for arguments.

    Args:
        denoiser: whose prediction it is.
    """

    def __init__(self, denoiser: Denoiser) -> None:
        super().__init__()
        self.denoiser = denoiser

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor]:
        """Return the predicted noise (B, A, C, L) of noisy samples and steps; *held* is a ``Prepared``."""
        x, step = free
        return (self.denoiser.predict(x, step, Prepared(*held)),)


class FastDenoiser:
    """Noise prediction of one network.

    Args:
        denoiser: the trained network.
        compiled: use machine code where there is any for it.
    """

    def __init__(self, denoiser: Denoiser, compiled: bool = True) -> None:
        self._net = denoiser
        self._predict = _compiled(denoiser) if compiled else denoiser.predict

    @torch.no_grad()
    def condition(self, context: Context) -> Noise:
        """Return ε(x, k) for the scenes of *context*, without gradients."""
        given = self._net.prepare(context)
        scenes, device = len(context.h), context.h.device

        @torch.no_grad()
        def noise(x: Tensor, k: int) -> Tensor:
            step = sinusoidal(torch.full((scenes,), k, device=device), STEP_WIDTH)
            return self._predict(x, step, given)

        return noise


def denoiser_package(options: ModelOptions, shape: tuple[int, int]) -> Path:
    """Return where the machine code for denoisers of *options* and *shape* ships, if it does."""
    sizes = options.model_dump(mode="json", include=set(_SIZES))
    return package_for("denoiser", {**sizes, "shape": list(shape)})


def _compiled(denoiser: Denoiser) -> Callable[[Tensor, Tensor, Prepared], Tensor]:
    """Return the prediction of *denoiser* by machine code, or its own where there is none."""
    code = machine_code(denoiser_package(denoiser.options, denoiser.shape), PredictionOnTensors(denoiser))
    if code is None:
        return denoiser.predict
    return lambda x, step, given: code([x, step], given)[0]
