"""Arrays and linear maps of the roll-out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

Array: TypeAlias = NDArray[Any]


@dataclass(frozen=True)
class Linear:
    """A linear map.

    Attributes:
        forth: (in, out).
        back: (out, in).
        bias: (out,).
    """

    forth: Array
    back: Array
    bias: Array

    @staticmethod
    def of(module: nn.Module) -> Linear:
        """Return the map of a linear layer."""
        assert isinstance(module, nn.Linear)  # noqa: S101 - tells the type checker what stands there
        weight, given = array_of(module.weight), dict(module.named_parameters()).get("bias")
        bias = np.zeros(len(weight), weight.dtype) if given is None else array_of(given)
        return Linear(np.ascontiguousarray(weight.T), weight, bias)

    def columns(self, begin: int, end: int) -> Linear:
        """Return the part that reads inputs *begin* to *end*, without the bias."""
        back = np.ascontiguousarray(self.back[:, begin:end])
        return Linear(np.ascontiguousarray(back.T), back, np.zeros_like(self.bias))

    def __call__(self, x: Array) -> Array:
        """Return *x* (…, in) mapped, (…, out)."""
        product: Array = x @ self.forth + self.bias
        return product


def array_of(tensor: Tensor) -> Array:
    """Return the numbers of *tensor*."""
    return np.ascontiguousarray(tensor.detach().cpu().numpy())


def relu(x: Array) -> Array:
    """Return *x* without what is below 0."""
    value: Array = np.maximum(x, 0.0)
    return value


def logistic(x: Array) -> Array:
    """Return 1 / (1 + exp(−x))."""
    value: Array = 0.5 * (1.0 + np.tanh(0.5 * x))
    return value
