"""What a roll-out of a whole scene leaves for roll-outs of some of its rows."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Trace:
    """Where everybody was at the beginning of each step, and what he said.

    Attributes:
        motion: (T, B, A, 4) x, y, yaw, speed.
        senders: (T, layers, B, A, M) what everybody adds to the others' messages.
    """

    motion: Tensor
    senders: Tensor

    def repeat(self, times: int) -> Trace:
        """Return the trace of the one scene *times* times."""
        return Trace(self.motion.expand(-1, times, -1, -1), self.senders.expand(-1, -1, times, -1, -1))
