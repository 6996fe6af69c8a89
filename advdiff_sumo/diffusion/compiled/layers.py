"""Interaction layers in which everybody of a scene hears everybody, on the CPU, for tensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.diffusion.compiled.backward import mix_back
from advdiff_sumo.diffusion.compiled.kernel import Array, array_of
from advdiff_sumo.diffusion.compiled.records import Activations, GraphWeights
from advdiff_sumo.diffusion.compiled.rollout import mix


class CompiledLayers:
    """Layers with their gradient, for scenes of which only the embeddings change.

    Args:
        weights: of the layers.
        edges: for each layer (B, A, A, M) what relative poses add to messages.
        attention_bias: (B, A) added to the scores: very negative where nobody is.
    """

    def __init__(self, weights: GraphWeights, edges: Sequence[Tensor], attention_bias: Tensor) -> None:
        self._weights = weights
        self._edges = array_of(torch.stack([edge.detach() for edge in edges], dim=1))  # (B, L, A, A, M)
        self._attention_bias = array_of(attention_bias)
        self._rows = np.arange(attention_bias.shape[1])

    def forward(self, h: Tensor) -> tuple[Tensor, list[Activations]]:
        """Return new embeddings (B, A, D) of *h*, and what :meth:`back` needs."""
        node, embeddings, kept = array_of(h), [], []
        _, layers, agents, _, wide = self._edges.shape
        for b in range(len(node)):
            senders = np.empty((layers, agents, wide), node.dtype)
            activations = room(self._weights, self._edges[b])
            embeddings.append(
                mix(self._weights, node[b], self._rows, self._attention_bias[b], senders, False, activations)
            )
            kept.append(activations)
        return torch.from_numpy(np.stack(embeddings)), kept

    def back(self, grad: Tensor, kept: list[Activations]) -> Tensor:
        """Return the gradient (B, A, D) of the embeddings for that of the new ones."""
        node = array_of(grad)
        gradients = [
            mix_back(self._weights, node[b], self._rows, activations) for b, activations in enumerate(kept)
        ]
        return torch.from_numpy(np.stack(gradients))


def room(weights: GraphWeights, edges: Array) -> Activations:
    """Return room for what the layers of a scene leave; its messages hold *edges* (L, A, A, M)."""
    layers, agents = edges.shape[:2]
    width, inner = weights.first.shape[1:]
    heads = weights.score.shape[1]

    def blank(*shape: int) -> Array:
        return np.empty((layers, agents, *shape), edges.dtype)

    return Activations(edges.copy(), blank(heads, agents), blank(width), blank(), blank(inner))
