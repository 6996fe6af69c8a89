"""Adam for one tensor, whose rows may be independent problems (Kingma and Ba 2015, Alg. 1).

PyTorch's Adam imports its compiler when it is constructed, which takes seconds in every worker.
"""

from __future__ import annotations

import torch
from torch import Tensor

_BETAS, _TINY = (0.9, 0.999), 1e-8


class Adam:
    """State of one minimisation.

    Args:
        rate: step size.
    """

    def __init__(self, rate: float) -> None:
        self._rate, self._steps = rate, 0
        self._first: Tensor | None = None
        self._second: Tensor | None = None

    def step(self, x: Tensor, gradient: Tensor) -> Tensor:
        """Return *x* after one step against its *gradient*."""
        zero, self._steps = torch.zeros_like(x), self._steps + 1
        self._first = torch.lerp(gradient, zero if self._first is None else self._first, _BETAS[0])
        squared = gradient.square()
        self._second = torch.lerp(squared, zero if self._second is None else self._second, _BETAS[1])
        mean = self._first / (1.0 - _BETAS[0] ** self._steps)
        pace = (self._second / (1.0 - _BETAS[1] ** self._steps)).sqrt() + _TINY
        return x - self._rate * mean / pace

    def keep(self, rows: Tensor) -> None:
        """Continue with only *rows* of the tensor."""
        if self._first is not None and self._second is not None:
            self._first, self._second = self._first[rows], self._second[rows]
