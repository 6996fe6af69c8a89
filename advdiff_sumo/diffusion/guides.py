"""Guidance: the mean of each denoising step is moved along the gradient of what attackers shall achieve.

The paper's guide is μ ← μ + α Σ ∇_μ Q(h, z, μ) (Sec. III-C, Alg. 1). Here each objective's gradient is masked to
the attackers and scaled to unit length over them before it is weighed, so that α means the same for every reward
model and scene: a step moves the attackers' latents by at most α √Σ in total (√Σ ≥ ``FLOOR``, or the last step,
where Σ is 0 and the decoder sees clean latents, would not be guided at all). A last step that begins with what was
left of the plan before moves them by at most ``MOST`` times as much.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from advdiff_sumo.diffusion.sampler import SamplingStep

MOST = 2.0
"""Longest shift of a last step that begins where the one before ended, in what one plan makes."""
FLOOR = 0.3
"""Least √Σ of a guided step."""

Objective: TypeAlias = Callable[[Tensor], Tensor]
"""Scaled latents (B, A, Z) → what shall grow (B,)."""


@dataclass(frozen=True)
class Sloped:
    """An objective that knows its own gradient, which spares PyTorch's.

    Attributes:
        value: the objective itself.
        slope: scaled latents (B, A, Z) → its gradient (B, A, Z) there.
    """

    value: Objective
    slope: Callable[[Tensor], Tensor]

    def __call__(self, latents: Tensor) -> Tensor:
        """Return what shall grow (B,)."""
        return self.value(latents)


@dataclass(frozen=True)
class Term:
    """An objective and when it counts.

    Attributes:
        objective: of the latents.
        weight: of its unit gradient.
        rungs: it counts in this many steps, the last ones.
    """

    objective: Objective
    weight: float
    rungs: int


@dataclass
class Guidance:
    """A guide of ``sampler.sample`` for latents.

    Attributes:
        terms: objectives; their unit gradients are added.
        attackers: (A,) who is moved.
        alpha: length of a step's shift in units of √Σ.
        turns: parts in which the last step's shift is made, each along the gradient where the ones before led.
        begin: (A, Z) where the last step's shift begins: what was left of the plan before. With it, a shift can
            grow from plan to plan up to ``MOST`` times what one plan makes.
        last_shift: (B, A, Z) that of the last step, once it is made.
    """

    terms: Sequence[Term]
    attackers: Tensor
    alpha: float
    turns: int = 1
    begin: Tensor | None = None
    last_shift: Tensor | None = None

    def __call__(self, mean: Tensor, rung: SamplingStep) -> Tensor:
        """Return what is added to *mean* (B, A, 1, Z)."""
        turns = self.turns if rung.left == 0 else 1
        length = self.alpha * max(rung.deviation, FLOOR) / turns
        shift = torch.zeros_like(mean[:, :, 0])
        if rung.left == 0 and self.begin is not None:
            shift = shift + self.begin * self.attackers[:, None]
        for _ in range(turns):
            latents = (mean[:, :, 0] + shift) / max(rung.alpha, 1e-2) ** 0.5
            shift = within(shift + length * self._uphill(latents, rung.left), MOST * turns * length)
        if rung.left == 0:
            self.last_shift = shift
        return shift[:, :, None]

    def _uphill(self, latents: Tensor, left: int) -> Tensor:
        """Return the weighted mean (B, A, Z) of the unit gradients of the terms that count."""
        total = sum(term.weight for term in self.terms)
        out = torch.zeros_like(latents)
        for term in self.terms:
            if left < term.rungs:
                out = out + term.weight / total * direction(term.objective, latents, self.attackers)
        return out


def within(shift: Tensor, most: float) -> Tensor:
    """Return *shift* (B, A, Z), shortened in scenes where it is longer than *most*."""
    norm = shift.square().sum(dim=(1, 2), keepdim=True).sqrt()
    return shift * (most / norm.clamp(min=1e-9)).clamp(max=1.0)


def direction(objective: Objective, latents: Tensor, attackers: Tensor) -> Tensor:
    """Return the gradient (B, A, Z) of *objective*, with length 1 over each scene, or 0.

    Only that of attackers, (A,) or (B, A), counts. A gradient that is not finite counts as none.
    """
    here = latents.detach()
    slope = objective.slope(here) if isinstance(objective, Sloped) else autograd_slope(objective, here)
    gradient = slope * attackers[..., None]
    norm = gradient.square().sum(dim=(1, 2), keepdim=True).sqrt()
    usable = torch.isfinite(norm) & (norm > 1e-12)
    return torch.where(usable, gradient / norm.clamp(min=1e-12), 0.0)


@torch.enable_grad()
def autograd_slope(objective: Objective, latents: Tensor) -> Tensor:
    """Return the gradient (B, A, Z) of *objective* at *latents* (B, A, Z) by autograd."""
    free = latents.detach().requires_grad_(True)
    return torch.autograd.grad(objective(free).sum(), free)[0]
