"""Perceptrons, and parts that begin as nothing, so that trained weights can be trained on with them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TypeVar

from torch import nn

_Layer = TypeVar("_Layer", nn.Linear, nn.Conv1d)


def perceptron(*widths: int, ends_in_relu: bool = False) -> nn.Sequential:
    """Return linear layers from each of *widths* to the next one, with ReLU behind each but the last, or that too."""
    layers = [layer for sizes in pairwise(widths) for layer in (nn.Linear(*sizes), nn.ReLU())]
    return nn.Sequential(*(layers if ends_in_relu else layers[:-1]))


def silent(layer: _Layer) -> _Layer:
    """Return *layer*, whose output begins as 0."""
    for weight in layer.parameters():
        nn.init.zeros_(weight)
    return layer


def from_nothing(
    inputs: int, hidden: int, outputs: int, activation: Callable[[], nn.Module] = nn.ReLU
) -> nn.Sequential:
    """Return a perceptron of one hidden layer whose output begins as 0."""
    last = silent(nn.Linear(hidden, outputs))  # made first: a seed gives the weights it always gave
    return nn.Sequential(nn.Linear(inputs, hidden), activation(), last)
