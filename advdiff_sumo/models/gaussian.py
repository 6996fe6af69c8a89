"""Diagonal Gaussians over latents."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Gaussian:
    """Independent normal distributions.

    Attributes:
        mean: (…, Z) means.
        logvar: (…, Z) logarithms of the variances.
    """

    mean: Tensor
    logvar: Tensor

    def sample(self, generator: torch.Generator | None = None) -> Tensor:
        """Return a draw (…, Z) through which gradients flow to mean and variance."""
        return self.mean + torch.exp(0.5 * self.logvar) * draw(self.mean, generator)

    def kl(self, other: Gaussian) -> Tensor:
        """Return KL(self ‖ other) (…, Z) of each component."""
        gap = (self.mean - other.mean) ** 2
        ratio = (torch.exp(self.logvar) + gap) * torch.exp(-other.logvar)
        return 0.5 * (other.logvar - self.logvar + ratio - 1.0)


def draw(like: Tensor, generator: torch.Generator | None) -> Tensor:
    """Return standard normal noise of the shape and on the device of *like*.

    It is drawn on the generator's device (None: on the CPU), so that a seed gives the same noise on every device.
    """
    home = generator.device if generator is not None else torch.device("cpu")
    return torch.randn(like.shape, generator=generator, dtype=like.dtype, device=home).to(like.device)
