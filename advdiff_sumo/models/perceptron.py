"""Perceptrons, and layers initialised to zero output, which can be added to a trained network."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TypeVar

from torch import nn

_Layer = TypeVar("_Layer", nn.Linear, nn.Conv1d)


def perceptron(*widths: int, ends_in_relu: bool = False) -> nn.Sequential:
    """Return linear layers of these *widths*, with ReLU after each but the last, and after that if *ends_in_relu*."""
    layers = [layer for sizes in pairwise(widths) for layer in (nn.Linear(*sizes), nn.ReLU())]
    return nn.Sequential(*(layers if ends_in_relu else layers[:-1]))


def zero_initialised(layer: _Layer) -> _Layer:
    """Return *layer* with all weights set to 0."""
    for weight in layer.parameters():
        nn.init.zeros_(weight)
    return layer


def zero_output_perceptron(
    inputs: int, hidden: int, outputs: int, activation: Callable[[], nn.Module] = nn.ReLU
) -> nn.Sequential:
    """Return a perceptron with one hidden layer, whose output is initialised to 0."""
    last = zero_initialised(nn.Linear(hidden, outputs))  # first: a seed gives the same weights as before
    return nn.Sequential(nn.Linear(inputs, hidden), activation(), last)
