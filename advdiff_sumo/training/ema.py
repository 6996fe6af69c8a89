"""Exponential moving average of the weights, which is what is evaluated and shipped.

``torch.optim.swa_utils.AveragedModel`` is a second copy of the module, with names of its own in every checkpoint, and
leaves to its user what is here: a decay that grows with the step, and letting the module have the average for a while.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor, nn


class Ema:
    """A running average of a module's floating-point state.

    Args:
        module: what is averaged.
        decay: share of the old average that is kept at each step, once warmed up; 0 follows the weights.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self.module = module
        self.shadow = {name: value.detach().clone() for name, value in module.state_dict().items()}

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Take in the weights after step number *step* (from 0); young averages follow faster."""
        decay = min(self.decay, (1.0 + step) / (10.0 + step))
        for name, value in self.module.state_dict().items():
            if value.is_floating_point():
                self.shadow[name].lerp_(value, 1.0 - decay)
            else:
                self.shadow[name].copy_(value)

    def load(self, state: Mapping[str, Tensor]) -> None:
        """Go on from a saved average."""
        for name, value in self.shadow.items():
            value.copy_(state[name])

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Let the module have the averaged weights for a while."""
        own = {name: value.detach().clone() for name, value in self.module.state_dict().items()}
        self.module.load_state_dict(self.shadow)
        try:
            yield
        finally:
            self.module.load_state_dict(own)
