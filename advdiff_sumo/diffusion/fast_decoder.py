"""The decoder at run time: ``models.decoder`` or ``models.closed_loop_decoder``, on CPUs with a compiled step.

It can also roll out a few agents while all others follow an earlier rollout. Guidance needs this: the gradient for one
or two attackers then costs a fraction of that for the whole scene.
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
    """Rolls out scenes.

    Args:
        decoder: the trained network; machine code copies its present weights.
        compiled: whether to use machine code, if there is any.

    Attributes:
        network, compiled: the arguments.
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
        """Return the futures of all agents, with exact gradients; see ``Decoder.forward``."""
        return self.network.forward(z, h, batch, steps, forced, self._step)

    @torch.no_grad()
    def whole(
        self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int = FUTURE_STEPS
    ) -> tuple[Rollout, Trace]:
        """Return futures and trace of all agents for latents *z* (B, A, Z), without gradients."""
        return self.network.roll(z, h, self._surroundings(batch), steps, by=self._step)

    def some(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> Rollout:
        """Return futures (B, R, …) of only the agents *rows* (R,); all others follow *trace*, of at least *steps*.

        With the paper's decoder the rows observe each other as in the trace, too. The result is then exact at the
        trace's latents; its gradient lacks the effect of changed positions on the interaction. Gradients flow to *z*
        (B, R, Z), the latents of the rows; *h* (B, A, D) are the embeddings of all agents.
        """
        around = self._surroundings(batch, rows)
        return self.network.roll(z, h[:, rows], around, steps, None, trace, self._step)[0]

    def _surroundings(self, batch: SceneBatch, rows: Tensor | None = None) -> Surroundings:
        """Return the surroundings of *rows* (None: all) of *batch*, from a cache of the last two."""
        for cached_batch, cached_rows, around in self._around:
            if cached_batch is batch and cached_rows is rows:
                return around
        around = self.network.surroundings(batch, rows)
        self._around = [*self._around[-1:], (batch, rows, around)]
        return around
