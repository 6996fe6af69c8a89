"""The decoder's memory, a gated recurrent unit, with its gradient."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import nn

from advdiff_sumo.traffic.baselines.joint.joint_arrays import Array, Linear, array_of, logistic


@dataclass(frozen=True)
class Kept:
    """One step; each (A, D).

    Attributes:
        before: the memory before it.
        reset, update, new: the gates.
        held: what the new memory takes of the one before, where nothing is reset.
    """

    before: Array
    reset: Array
    update: Array
    new: Array
    held: Array


class Cell:
    """The unit.

    Args:
        cell: the trained one.
    """

    def __init__(self, cell: nn.GRUCell) -> None:
        self._from_input, self._from_memory = (
            Linear(np.ascontiguousarray(weight.T), weight, array_of(bias))
            for weight, bias in (
                (array_of(cell.weight_ih), cell.bias_ih),
                (array_of(cell.weight_hh), cell.bias_hh),
            )
        )

    def keep(self, inputs: Array, memory: Array) -> tuple[Array, Kept]:
        """Return the memory (A, D) after *inputs* (A, D + 2), and what :meth:`keep_back` needs."""
        wide = memory.shape[1]
        mine, held = self._from_input(inputs), self._from_memory(memory)
        gates = logistic(mine[:, : 2 * wide] + held[:, : 2 * wide])
        reset, update, last = gates[:, :wide], gates[:, wide:], held[:, 2 * wide :]
        new = np.tanh(mine[:, 2 * wide :] + reset * last)
        return new + update * (memory - new), Kept(memory, reset, update, new, last)

    def keep_back(self, kept: Kept, grad: Array) -> tuple[Array, Array]:
        """Return the gradients of the input (A, D + 2) and of the memory before, for *grad* of that after."""
        by_new = grad * (1.0 - kept.update) * (1.0 - kept.new**2)
        by_reset = by_new * kept.held * kept.reset * (1.0 - kept.reset)
        by_update = grad * (kept.before - kept.new) * kept.update * (1.0 - kept.update)
        gradient = np.concatenate((by_reset, by_update, by_new), axis=1)
        held = np.concatenate((by_reset, by_update, by_new * kept.reset), axis=1)
        return gradient @ self._from_input.back, grad * kept.update + held @ self._from_memory.back
