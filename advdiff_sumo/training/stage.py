"""What a stage of the training gives the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle

Tally = dict[str, tuple[float, float]]
"""Name of a figure → its sum and its weight; figures of several batches are added, then divided."""


@dataclass(frozen=True)
class Moment:
    """Where the training stands.

    Attributes:
        step: steps done, from 0.
        total: all steps of the training.
        generator: the only source of chance in this step.
    """

    step: int
    total: int
    generator: torch.Generator

    @property
    def progress(self) -> float:
        """Share of the training that is done, 0 … 1."""
        return min(self.step / max(self.total, 1), 1.0)


class Stage(Protocol):
    """One stage: what is trained, with which loss, and how it is judged.

    Attributes:
        name: of ``presets.STAGES``.
        monitor: figure of :meth:`evaluate` whose fall is progress.
        module: what the optimiser changes and what the moving average covers.
        beside: further state that a resumed run needs, such as a target network; empty for most.
    """

    name: str
    monitor: str
    module: nn.Module
    beside: nn.Module

    def loss(self, batch: SceneBatch, moment: Moment) -> dict[str, Tensor]:
        """Return the terms; "loss" is the one that is differentiated."""
        ...

    def evaluate(self, batch: SceneBatch, generator: torch.Generator) -> Tally:
        """Judge a held-out batch, without gradients."""
        ...

    def after_step(self) -> None:
        """Do what follows a step of the optimiser: mostly nothing."""
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
    """Return each figure's mean; figures without weight are left out."""
    return {name: value / weight for name, (value, weight) in tally.items() if weight > 0.0}
