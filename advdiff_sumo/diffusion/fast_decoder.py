"""The decoder for run time: the same network as ``models.decoder``, equal up to rounding, in fewer operations.

It can also roll out a few rows of a scene against the rest of an earlier rollout, which is what guidance needs:
the gradient for one or two attackers then costs a fraction of that for the whole scene. On the CPU that is done by
``compiled``, elsewhere by the network itself. A closed-loop decoder rolls out itself on every device, where there is
any by the machine code of ``exported_step``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from advdiff_sumo.diffusion.exported_step import ExportedStep, exported_step
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.closed_loop_decoder import ClosedLoopDecoder
from advdiff_sumo.models.decoder import Decoder, Rollout
from advdiff_sumo.models.model_options import FUTURE_STEPS
from advdiff_sumo.models.trace import Trace

if TYPE_CHECKING:
    from advdiff_sumo.diffusion.compiled.decoder_kernel import CompiledDecoder


class FastDecoder:
    """Rolls out scenes of one plan.

    Args:
        decoder: the trained network; its weights are read when this is made.
        compiled: roll out by compiled loops; None: where the network is on the CPU, and for a closed-loop decoder
            where there is machine code for it.

    Attributes:
        compiled: the compiled form of an open decoder, or None where it is not used.
        closed_loop: whether the network is a closed-loop decoder.
    """

    def __init__(self, decoder: Decoder, compiled: bool | None = None) -> None:
        self.compiled: CompiledDecoder | None = None
        self.closed_loop = isinstance(decoder, ClosedLoopDecoder)
        self._roller: CompiledDecoder | NetworkRoller
        if isinstance(decoder, ClosedLoopDecoder):
            self._roller = NetworkRoller(decoder, exported_step(decoder) if compiled is not False else None)
            return
        here = decoder.start.weight.device.type == "cpu" if compiled is None else compiled
        self.compiled = _compiled(decoder) if here else None
        self._roller = self.compiled or NetworkRoller(decoder)

    def whole(
        self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int = FUTURE_STEPS
    ) -> tuple[Rollout, Trace]:
        """Return the futures of all agents, without gradients, and their trace.

        Args:
            z: (B, A, Z) latents.
            h: (B, A, D) embeddings.
            batch: the scenes.
            steps: model steps to roll out.
        """
        return self._roller.whole(z, h, batch, steps)

    def some(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> Rollout:
        """Return the futures (B, R, …) of agents *rows* alone, the others as in *trace*; gradients flow to *z*.

        What the rows see of each other and of the others is that of the trace too, so the result is exact at the
        latents of the trace, and its gradient lacks what a changed place would change in the interaction.

        Args:
            z: (B, R, Z) latents of the rows.
            h: (B, A, D) embeddings of all.
            batch: the scenes.
            rows: (R,) agents, the same in every scene.
            steps: model steps, at most those of the trace.
            trace: of the whole scene.
        """
        return self._roller.some(z, h, batch, rows, steps, trace)


@dataclass(frozen=True)
class NetworkRoller:
    """Rolls out by the network, without gradients by machine code for its step.

    Attributes:
        decoder: the network.
        step: its compiled step; None: its own.
    """

    decoder: Decoder
    step: ExportedStep | None = None

    def whole(self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int) -> tuple[Rollout, Trace]:
        """As :meth:`FastDecoder.whole`."""
        return self.decoder.whole(z, h, batch, steps, self.step)

    def some(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> Rollout:
        """As :meth:`FastDecoder.some`."""
        slope = torch.is_grad_enabled() and z.requires_grad
        return self.decoder.some(z, h, batch, rows, steps, trace, None if slope else self.step)


def _compiled(decoder: Decoder) -> CompiledDecoder:
    """Return the compiled form; who never asks for it does not wait for the compiler's import."""
    from advdiff_sumo.diffusion.compiled.decoder_kernel import CompiledDecoder
    from advdiff_sumo.diffusion.compiled.kernel_cache import link_shipped

    link_shipped()
    return CompiledDecoder(decoder)
