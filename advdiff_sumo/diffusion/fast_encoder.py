"""The context encoder for run time: on the CPU compiled loops mix the agents, all else is ``models.context``."""

from __future__ import annotations

import torch

from advdiff_sumo.diffusion.fast_reward import layers_of
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.context import Context, ContextEncoder
from advdiff_sumo.models.interaction import ABSENT


class FastEncoder:
    """Embeds scenes, equal to the network up to rounding.

    Args:
        encoder: the trained network; the weights of its layers are read when this is made.
        compiled: let compiled loops mix the agents; None: where the network is on the CPU.
    """

    def __init__(self, encoder: ContextEncoder, compiled: bool | None = None) -> None:
        self._net = encoder
        here = encoder.prior.weight.device.type == "cpu" if compiled is None else compiled
        self._layers = layers_of(encoder.interaction.in_order(), compiled=True) if here else None

    @torch.no_grad()
    def __call__(self, batch: SceneBatch) -> Context:
        """Return embeddings and prior of *batch*, without gradients."""
        if self._layers is None:
            context: Context = self._net(batch)
            return context
        h, relative = self._net.alone(batch)
        attention_bias = torch.where(batch.present, 0.0, ABSENT).to(h.dtype)
        mixed, _ = self._layers(self._net.interaction.prepare(relative), attention_bias).forward(h)
        return self._net.known(mixed * batch.present[..., None], relative, batch)
