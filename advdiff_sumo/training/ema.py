"""Exponential moving average of the weights, which is what is evaluated and shipped.

``torch.optim.swa_utils.AveragedModel`` is a second copy of the module with other tensor names in every checkpoint, and
lacks what is needed here: a decay that grows with the step, and swapping the average into the module temporarily.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor, nn


class Ema:
    """A running average of a module's floating-point state.

    Args:
        module: whose state is averaged.
        decay: factor of the old average in each step, after the first steps; 0: no averaging.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self.module = module
        self.shadow = {name: value.detach().clone() for name, value in module.state_dict().items()}

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Update the average after step number *step* (from 0); in the first steps the decay is smaller."""
        decay = min(self.decay, (1.0 + step) / (10.0 + step))
        for name, value in self.module.state_dict().items():
            if value.is_floating_point():
                self.shadow[name].lerp_(value, 1.0 - decay)
            else:
                self.shadow[name].copy_(value)

    def load(self, state: Mapping[str, Tensor]) -> None:
        """Continue from a saved average."""
        for name, value in self.shadow.items():
            value.copy_(state[name])

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Give the module the averaged weights inside a ``with`` block."""
        own = {name: value.detach().clone() for name, value in self.module.state_dict().items()}
        self.module.load_state_dict(self.shadow)
        try:
            yield
        finally:
            self.module.load_state_dict(own)
