"""Warm-up: refits only Q to a new planner's behaviour in the first interactive steps (Sec. III-C)."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import torch
from torch import Tensor

from advdiff_sumo.core.errors import TrainingError
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.training.experience import Experience, gathered
from advdiff_sumo.training.gradient_alignment import direction_loss
from advdiff_sumo.training.presets import RewardOptions
from advdiff_sumo.training.reward_stage import follow, q_loss


class WarmUp:
    """Refits the reward model of a bundle in place; the other networks do not change.

    Args:
        bundle: trained networks.
        options: those of the pretraining.
        learning_rate: of Adam.
        batch_size: experiences in a step.
        seed: of the order and of the candidate actions.
    """

    def __init__(
        self,
        bundle: Bundle,
        options: RewardOptions,
        learning_rate: float = 1e-3,
        batch_size: int = 16,
        seed: int = 0,
    ) -> None:
        self.bundle, self.options, self.batch_size = bundle, options, batch_size
        self.tree = SeedTree(seed, ("warm-up",))
        self._target = copy.deepcopy(bundle.reward).requires_grad_(False)
        for frozen in (bundle.traffic, bundle.denoiser):
            frozen.eval().requires_grad_(False)
        self._parameters = list(bundle.reward.requires_grad_(True).parameters())
        self._optimiser = torch.optim.Adam(self._parameters, lr=learning_rate)
        self._steps = 0

    def fit(self, stored: Sequence[Experience], steps: int) -> list[float]:
        """Take *steps* optimiser steps on random batches of *stored* and return the losses.

        Args:
            stored: experiences of a run, see ``experience.observed``; each may hold several scenes.
            steps: number of optimiser steps.

        Raises:
            TrainingError: a loss is not a number.
            ValueError: nothing is stored.
        """
        if not stored:
            raise ValueError("no experience to learn from")
        return [self._step(stored) for _ in range(steps)]

    def _step(self, stored: Sequence[Experience]) -> float:
        loss = self._loss(stored)
        if not torch.isfinite(loss):
            raise TrainingError(f"warm-up step {self._steps}: the loss is {float(loss.detach())}")
        self._optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self._parameters, 5.0)
        self._optimiser.step()
        follow(self._target, self.bundle.reward, self.options.target_decay)
        self._steps += 1
        return float(loss.detach())

    def _loss(self, stored: Sequence[Experience]) -> Tensor:
        """Return the loss of a random batch of *stored*, which may be on another device than the networks."""
        node = self.tree.child(self._steps)
        drawn = node.child("draw").generator().integers(0, len(stored), min(self.batch_size, len(stored)))
        experience = gathered([stored[i] for i in drawn]).to(self._parameters[0].device)
        generator = torch.Generator().manual_seed(node.child("noise").integer(62))
        total, _ = q_loss(self.bundle, self._target, experience, self.options, generator)
        loss = total / experience.weight.sum().clamp(min=1.0)
        if self.options.direction > 0.0:
            loss = loss + self.options.direction * direction_loss(
                self.bundle, experience, self.options, generator
            )
        return loss
