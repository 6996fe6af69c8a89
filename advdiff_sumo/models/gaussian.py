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
        noise = torch.randn(
            self.mean.shape, generator=generator, dtype=self.mean.dtype, device=_home(generator)
        )
        return self.mean + torch.exp(0.5 * self.logvar) * noise.to(self.mean.device)

    def log_prob(self, value: Tensor) -> Tensor:
        """Return log densities (…,) of *value* (…, Z), summed over the latent's numbers."""
        squared = (value - self.mean) ** 2 * torch.exp(-self.logvar)
        return -0.5 * (squared + self.logvar + 1.8378770664093453).sum(-1)  # ln 2π

    def kl(self, other: Gaussian) -> Tensor:
        """Return KL(self ‖ other) (…, Z) of each number."""
        gap = (self.mean - other.mean) ** 2
        ratio = (torch.exp(self.logvar) + gap) * torch.exp(-other.logvar)
        return 0.5 * (other.logvar - self.logvar + ratio - 1.0)


def _home(generator: torch.Generator | None) -> torch.device:
    """Return where noise is drawn: on the generator's device, so that seeds mean the same everywhere."""
    return generator.device if generator is not None else torch.device("cpu")
