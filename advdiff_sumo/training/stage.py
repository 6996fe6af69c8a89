"""The interface between training stages and the training loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle

Tally = dict[str, tuple[float, float]]
"""Name of a figure → its sum and its weight, which are added over batches."""


@dataclass(frozen=True)
class Moment:
    """Present step of a training.

    Attributes:
        step: finished steps.
        total: all steps of the training.
        generator: of all random numbers of this step.
    """

    step: int
    total: int
    generator: torch.Generator

    @property
    def progress(self) -> float:
        """Finished share of the training, 0 … 1."""
        return min(self.step / max(self.total, 1), 1.0)


class Stage(Protocol):
    """One stage: trained networks, loss and evaluation.

    Attributes:
        name: of ``presets.STAGES``.
        monitor: figure of :meth:`evaluate` that decides which weights are best; lower is better.
        module: whose weights are trained and averaged.
        beside: further state to save in checkpoints, such as a target network; empty for most stages.
    """

    name: str
    monitor: str
    module: nn.Module
    beside: nn.Module

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return the loss and figures to record; only "loss" is differentiated."""
        ...

    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:
        """Evaluate a held-out batch, without gradients."""
        ...

    def after_step(self) -> None:
        """Called after each step of the optimiser; by default, do nothing."""
        return


class BundleStage(Stage):
    """A stage that trains *module*, a part of *bundle*, in place."""

    def __init__(self, bundle: Bundle, module: nn.Module, beside: nn.Module | None = None) -> None:
        self.bundle, self.module = bundle, module
        self.beside = nn.Module() if beside is None else beside


def add(total: Tally, more: Mapping[str, tuple[float, float]]) -> None:
    """Add *more* to *total*, in place."""
    for name, (value, weight) in more.items():
        before = total.get(name, (0.0, 0.0))
        total[name] = (before[0] + value, before[1] + weight)


def means(tally: Tally) -> dict[str, float]:
    """Return the mean of each figure; figures without weight are left out."""
    return {name: value / weight for name, (value, weight) in tally.items() if weight > 0.0}
