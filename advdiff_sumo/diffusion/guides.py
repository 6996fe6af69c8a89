"""Guidance: the mean of each denoising step is moved along the gradient of what attackers shall achieve.

The paper's guide is μ ← μ + α Σ ∇_μ Q(h, z, μ) (Sec. III-C, Alg. 1). Here each objective's gradient is masked to
the attackers and scaled to unit length over them before it is weighed, so that α means the same for every reward
model and scene: a step moves the attackers' latents by at most α √Σ in total (√Σ ≥ ``FLOOR``, or the last step,
where Σ is 0 and the decoder sees clean latents, would not be guided at all).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from advdiff_sumo.diffusion.fast_reward import FastReward
from advdiff_sumo.diffusion.sampler import Rung
from advdiff_sumo.models.reward import RewardModel, RewardState

FLOOR = 0.3
"""Least √Σ of a guided step."""

Objective: TypeAlias = Callable[[Tensor], Tensor]
"""Scaled latents (B, A, Z) → what shall grow (B,)."""


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


@dataclass(frozen=True)
class Guidance:
    """A guide of ``sampler.sample`` for latents.

    Attributes:
        terms: objectives; their unit gradients are added.
        attackers: (A,) who is moved.
        alpha: length of a step's shift in units of √Σ.
    """

    terms: Sequence[Term]
    attackers: Tensor
    alpha: float

    def __call__(self, mean: Tensor, rung: Rung) -> Tensor:
        """Return what is added to *mean* (B, A, 1, Z)."""
        shift = torch.zeros_like(mean[:, :, 0])
        total = sum(term.weight for term in self.terms)
        for term in self.terms:
            if rung.left < term.rungs:
                latents = mean[:, :, 0] / max(rung.alpha, 1e-2) ** 0.5
                shift = shift + term.weight / total * direction(term.objective, latents, self.attackers)
        return (self.alpha * max(rung.deviation, FLOOR) * shift)[:, :, None]


def direction(objective: Objective, latents: Tensor, attackers: Tensor) -> Tensor:
    """Return the gradient (B, A, Z) of *objective*, of attackers (A,) only, with length 1 over each scene, or 0.

    A gradient that is not finite counts as none.
    """
    with torch.enable_grad():
        free = latents.detach().requires_grad_(True)
        gradient = torch.autograd.grad(objective(free).sum(), free)[0]
    gradient = gradient * attackers[:, None]
    norm = gradient.square().sum(dim=(1, 2), keepdim=True).sqrt()
    usable = torch.isfinite(norm) & (norm > 1e-12)
    return torch.where(usable, gradient / norm.clamp(min=1e-12), 0.0)


def reward_objective(model: RewardModel, state: RewardState) -> Objective:
    """Return Q(h, z, ·), the discounted adversarial reward of the scenes in *state*."""
    return FastReward(model, state)
