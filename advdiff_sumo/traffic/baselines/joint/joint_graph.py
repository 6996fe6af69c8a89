"""One graph layer in which everybody hears everybody, as ``models.interaction.InteractionLayer``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from advdiff_sumo.models.interaction import InteractionLayer
from advdiff_sumo.traffic.baselines.joint.joint_arrays import Array, Linear, array_of, relu


@dataclass(frozen=True)
class Activations:
    """What the gradient of a layer needs.

    Attributes:
        message: (A, A, M) after the ReLU; the first index is who hears.
        weight: (A, A, H) attention.
        normal: (A, D) the norm's input, less its mean, over its deviation.
        sharp: (A, 1) one over that deviation.
        hidden: (A, D) inside the last two products.
    """

    message: Array
    weight: Array
    normal: Array
    sharp: Array
    hidden: Array


class Layer:
    """A graph layer.

    Args:
        layer: the trained one.
    """

    def __init__(self, layer: InteractionLayer) -> None:
        self._heads = layer.heads
        self._receiver, self._sender = Linear.of(layer.receiver), Linear.of(layer.sender)
        self._edge, self._score, self._out = (Linear.of(x) for x in (layer.edge, layer.score, layer.out))
        self._scale, self._shift, self._eps = (
            array_of(layer.norm.weight),
            array_of(layer.norm.bias),
            layer.norm.eps,
        )
        self._first, self._second = Linear.of(layer.mix[0]), Linear.of(layer.mix[2])

    def forward(self, h: Array, embedded: Array) -> tuple[Array, Activations]:
        """Return new embeddings (A, D) of *h* among looks *embedded* (A, A, E), and what :meth:`back` needs."""
        count, heads = len(h), self._heads
        edge = (embedded.reshape(count * count, -1) @ self._edge.forth).reshape(count, count, -1)
        message = relu(edge + self._receiver(h)[:, None] + self._sender(h))
        score = message @ self._score.forth
        weight = np.exp(score - score.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        split = message.reshape(count, count, heads, -1)
        gathered = (weight[..., None] * split).sum(axis=1).reshape(count, -1)
        into = h + self._out(gathered)
        into -= into.mean(axis=1, keepdims=True)
        sharp = 1.0 / np.sqrt((into * into).mean(axis=1, keepdims=True) + self._eps)
        normal = into * sharp
        mixed = normal * self._scale + self._shift
        hidden = relu(self._first(mixed))
        return mixed + self._second(hidden), Activations(message, weight, normal, sharp, hidden)

    def back(self, activations: Activations, grad: Array) -> tuple[Array, Array]:
        """Return the gradients of embeddings (A, D) and of looks (A, A, E) for *grad* (A, D) of the new embeddings."""
        count = len(grad)
        mixed = grad + ((grad @ self._second.back) * (activations.hidden > 0.0)) @ self._first.back
        by = mixed * self._scale
        by = by - by.mean(axis=1, keepdims=True)
        into = activations.sharp * (
            by - activations.normal * (by * activations.normal).mean(axis=1, keepdims=True)
        )
        gathered = (into @ self._out.back).reshape(count, 1, self._heads, -1)
        split = activations.message.reshape(count, count, self._heads, -1)
        weight = (gathered * split).sum(axis=-1)
        score = activations.weight * (weight - (activations.weight * weight).sum(axis=1, keepdims=True))
        message = (activations.weight[..., None] * gathered).reshape(
            activations.message.shape
        ) + score @ self._score.back
        message *= activations.message > 0.0
        before = into + message.sum(axis=1) @ self._receiver.back + message.sum(axis=0) @ self._sender.back
        looks = message.reshape(count * count, -1) @ self._edge.back
        return before, looks.reshape(count, count, -1)
