"""The fixed noise schedule: βᵏ and αᵏ = Π (1 − βˢ), Sec. III-B."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import torch
from torch import Tensor


@dataclass(frozen=True)
class NoiseSchedule:
    """Diffusion steps k = 1 … K; index 0 is data without noise, α⁰ = 1.

    Attributes:
        steps: K.
        kind: "cosine" (Nichol and Dhariwal 2021) or "linear" (Ho et al. 2020, scaled to K steps).
    """

    steps: int = 100
    kind: Literal["cosine", "linear"] = "cosine"

    @cached_property
    def alpha(self) -> Tensor:
        """(K + 1,) cumulative products αᵏ, double precision."""
        k = torch.arange(self.steps + 1, dtype=torch.float64)
        if self.kind == "cosine":
            f = torch.cos((k / self.steps + 0.008) / 1.008 * math.pi / 2.0) ** 2
            return (f / f[0]).clamp(min=1e-4)
        scale = 1000.0 / self.steps
        beta = torch.linspace(1e-4 * scale, 0.02 * scale, self.steps, dtype=torch.float64).clamp(max=0.999)
        return torch.cat((torch.ones(1, dtype=torch.float64), torch.cumprod(1.0 - beta, 0)))

    def noisy(self, x0: Tensor, k: Tensor, noise: Tensor) -> Tensor:
        """Return √αᵏ x⁰ + √(1 − αᵏ) ε of data (B, …) at steps *k* (B,), with standard normal *noise* (B, …)."""
        alpha = self.alpha.to(x0.device)[k].to(x0.dtype).reshape(-1, *([1] * (x0.dim() - 1)))
        return alpha.sqrt() * x0 + (1.0 - alpha).sqrt() * noise

    def ladder(self, count: int, begin: float = 1.0) -> list[int]:
        """Return *count* + 1 evenly spaced steps k, descending to 0.

        Args:
            count: number of transitions.
            begin: the first step is this share of K, at least *count*.

        Raises:
            ValueError: *count* is less than 1 or more than K.
        """
        if not 1 <= count <= self.steps:
            raise ValueError(f"{count} sampling steps; the schedule has {self.steps}")
        first = max(round(begin * self.steps), count)
        return [round(first * (count - i) / count) for i in range(count + 1)]
