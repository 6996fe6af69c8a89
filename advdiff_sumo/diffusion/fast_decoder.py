"""The decoder for run time: ``models.decoder`` and ``models.closed_loop_decoder``, on a CPU by machine code for a step.

It can also roll out a few rows of a scene against the rest of an earlier rollout, which is what guidance needs:
the gradient for one or two attackers then costs a fraction of that for the whole scene.
"""

from __future__ import annotations

import torch
from torch import Tensor

from advdiff_sumo.diffusion.exported_step import exported_step
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.decoder import Decoder, Forced, Rollout, Surroundings, Trace
from advdiff_sumo.models.model_options import FUTURE_STEPS


class FastDecoder:
    """Rolls out scenes of one plan.

    Args:
        decoder: the trained network; machine code takes its weights as they are now.
        compiled: step by machine code where there is any for it.

    Attributes:
        network, compiled: the same.
        closed_loop: whether the network is a closed-loop decoder.
    """

    def __init__(self, decoder: Decoder, compiled: bool = True) -> None:
        self.closed_loop = isinstance(decoder, ClosedLoopDecoder)
        self.network, self.compiled = decoder, compiled
        self._step = exported_step(decoder) if compiled else None
        self._around: list[tuple[SceneBatch, Tensor | None, Surroundings]] = []

    def __call__(
        self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int = FUTURE_STEPS, forced: Forced | None = None
    ) -> Rollout:
        """Return the futures of all agents, with the whole gradient; see ``Decoder.forward``."""
        return self.network.forward(z, h, batch, steps, forced, self._step)

    @torch.no_grad()
    def whole(
        self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int = FUTURE_STEPS
    ) -> tuple[Rollout, Trace]:
        """Return the futures of all agents for latents *z* (B, A, Z), without gradients, and their trace."""
        return self.network.roll(z, h, self._surroundings(batch), steps, by=self._step)

    def some(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> Rollout:
        """Return the futures (B, R, …) of agents *rows* (R,) alone, the others as in *trace*, with at least *steps*.

        What the rows see of each other and of the others is that of the trace too, so the result is exact at the
        latents of the trace, and its gradient lacks what a changed place would change in the interaction. Gradients
        flow to *z* (B, R, Z), the latents of the rows; *h* (B, A, D) are the embeddings of all.
        """
        around = self._surroundings(batch, rows)
        return self.network.roll(z, h[:, rows], around, steps, None, trace, self._step)[0]

    def _surroundings(self, batch: SceneBatch, rows: Tensor | None = None) -> Surroundings:
        """Return the surroundings of *rows* (None: all) of *batch*; a plan needs those of all and of some twice."""
        for known, some, around in self._around:
            if known is batch and some is rows:
                return around
        around = self.network.surroundings(batch, rows)
        self._around = [*self._around[-1:], (batch, rows, around)]
        return around
