"""Guidance: the mean of a denoising step is shifted along the gradient of the attack's objectives.

The paper's guide is μ ← μ + α Σ ∇_μ Q(h, z, μ) (Sec. III-C, Alg. 1). Here each objective's gradient is masked to the
attackers and scaled to unit length before it is weighted, so that α means the same for every reward model and scene: a
step shifts the attackers' latents by at most α √Σ in total. √Σ is at least ``FLOOR``; the last step, where Σ is 0 and
latents are clean, would not be guided otherwise. If the last step starts from the previous plan's shift, the shift may
be up to ``MOST`` times as long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from advdiff_sumo.diffusion.sampler import SamplingStep

MOST = 2.0
"""Longest shift of the last step that starts from the previous plan's shift, relative to that of one plan."""
FLOOR = 0.3
"""Least √Σ of a guided step."""

Objective: TypeAlias = Callable[[Tensor], Tensor]
"""Scaled latents (B, A, Z) → value to maximise (B,)."""


@dataclass(frozen=True)
class Sloped:
    """An objective with a gradient of its own, used in place of autograd.

    Attributes:
        value: the objective.
        slope: scaled latents (B, A, Z) → gradient (B, A, Z).
    """

    value: Objective
    slope: Callable[[Tensor], Tensor]

    def __call__(self, latents: Tensor) -> Tensor:
        """Return the value (B,) of the objective."""
        return self.value(latents)


@dataclass(frozen=True)
class Term:
    """An objective, and the denoising steps in which it acts.

    Attributes:
        objective: of the latents.
        weight: of its unit gradient.
        rungs: number of the last denoising steps in which it acts.
    """

    objective: Objective
    weight: float
    rungs: int


@dataclass
class Guidance:
    """A guide of ``sampler.sample`` for latents.

    Attributes:
        terms: objectives, whose weighted unit gradients are added.
        attackers: (A,) 1 for attackers, whose latents are shifted, else 0.
        alpha: length of a step's shift in units of √Σ.
        turns: number of gradient steps that make up the shift of the last denoising step.
        begin: (A, Z) initial shift of the last denoising step, from the previous plan; so shifts can grow from plan to
            plan, up to ``MOST`` times that of one plan.
        last_shift: (B, A, Z) shift of the last denoising step, once computed.
    """

    terms: Sequence[Term]
    attackers: Tensor
    alpha: float
    turns: int = 1
    begin: Tensor | None = None
    last_shift: Tensor | None = None

    def __call__(self, mean: Tensor, rung: SamplingStep) -> Tensor:
        """Return the shift to add to *mean* (B, A, 1, Z)."""
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
        """Return the weighted mean (B, A, Z) of the unit gradients of the terms that act in this step."""
        total = sum(term.weight for term in self.terms)
        out = torch.zeros_like(latents)
        for term in self.terms:
            if left < term.rungs:
                out = out + term.weight / total * direction(term.objective, latents, self.attackers)
        return out


def within(shift: Tensor, most: float) -> Tensor:
    """Return *shift* (B, A, Z), shortened to length *most* in scenes where it is longer."""
    norm = shift.square().sum(dim=(1, 2), keepdim=True).sqrt()
    return shift * (most / norm.clamp(min=1e-9)).clamp(max=1.0)


def direction(objective: Objective, latents: Tensor, attackers: Tensor) -> Tensor:
    """Return the gradient (B, A, Z) of *objective*, scaled to length 1 in each scene.

    It is masked by *attackers*, (A,) or (B, A). It is 0 in scenes where it vanishes or is not finite.
    """
    point = latents.detach()
    slope = objective.slope(point) if isinstance(objective, Sloped) else autograd_slope(objective, point)
    gradient = slope * attackers[..., None]
    norm = gradient.square().sum(dim=(1, 2), keepdim=True).sqrt()
    usable = torch.isfinite(norm) & (norm > 1e-12)
    return torch.where(usable, gradient / norm.clamp(min=1e-12), 0.0)


@torch.enable_grad()
def autograd_slope(objective: Objective, latents: Tensor) -> Tensor:
    """Return the gradient (B, A, Z) of *objective* at *latents* (B, A, Z) by autograd."""
    free = latents.detach().requires_grad_(True)
    return torch.autograd.grad(objective(free).sum(), free)[0]
