"""Parts that begin as nothing, so that trained weights can be trained on with them."""

from __future__ import annotations

from collections.abc import Callable

from torch import nn


def from_nothing(
    inputs: int, hidden: int, outputs: int, activation: Callable[[], nn.Module] = nn.ReLU
) -> nn.Sequential:
    """Return a perceptron of one hidden layer whose output begins as 0."""
    last = nn.Linear(hidden, outputs)
    nn.init.zeros_(last.weight)
    nn.init.constant_(last.bias, 0.0)
    return nn.Sequential(nn.Linear(inputs, hidden), activation(), last)
