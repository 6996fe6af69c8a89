"""What all vehicles' noisy latents say to each other at a step of the denoiser, on the CPU."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.diffusion.compiled.kernel import Array, affine, array_of, kernel, product, relu
from advdiff_sumo.diffusion.compiled.layers import room
from advdiff_sumo.diffusion.compiled.records import Activations, GraphWeights
from advdiff_sumo.diffusion.compiled.rollout import mix
from advdiff_sumo.diffusion.compiled.weights import graph_weights
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.denoiser import STEP_WIDTH, Coupling, sinusoidal
from advdiff_sumo.models.interaction import ABSENT


class CouplingWeights(NamedTuple):
    """Weights (in, out) of the noisy latents, and of the result with its bias."""

    sample: Array
    out: Array
    out_bias: Array


@kernel
def couple(
    w: CouplingWeights,
    graph: GraphWeights,
    x: Array,
    begin: Array,
    attention_bias: Array,
    drawn: BoolArray,
    activations: Activations,
    h: Array,
) -> Array:
    """Return what coupling adds to the embeddings of a scene, and those, (A, D).

    Args:
        w: weights.
        graph: of the layers.
        x: (A, C L) noisy latents.
        begin: (A, M) what is known without them; overwritten.
        attention_bias: (A,) added to the scores of senders: very negative where nobody is drawn.
        drawn: (A,) whose latents mean something.
        activations: room of the layers, its messages what relative poses add to them; overwritten.
        h: (A, D) embeddings.
    """
    product(x, w.sample, begin)
    relu(begin)
    layers, agents, _, wide = activations.message.shape
    senders = np.empty((layers, agents, wide), x.dtype)
    mixed = mix(graph, begin, np.arange(agents), attention_bias, senders, False, activations)
    for a in range(agents):
        if not drawn[a]:
            mixed[a] = x.dtype.type(0.0)
    out = np.empty(h.shape, x.dtype)
    affine(mixed, w.out, w.out_bias, out)
    for a in range(agents):
        for d in range(h.shape[1]):
            out[a, d] += h[a, d]
    return out


class CompiledCoupling:
    """The coupling of one network along one ladder of steps.

    Args:
        layer: trained; its weights are read when this is made.
        steps: the diffusion steps at which it will be asked.
    """

    def __init__(self, layer: Coupling, steps: Iterable[int]) -> None:
        self._layer = layer
        self._graph = graph_weights(layer.net.in_order())
        self._weights = CouplingWeights(
            array_of(layer.sample.weight.t()), array_of(layer.out.weight.t()), array_of(layer.out.bias)
        )
        with torch.no_grad():
            codes = {k: layer.step(sinusoidal(torch.tensor([k]), STEP_WIDTH))[0] for k in steps}
        self._codes = {k: array_of(code) for k, code in codes.items()}

    def of(self, context: Context) -> CoupledScenes:
        """Return what depends on no sample, for the scenes of *context*."""
        layer = self._layer
        with torch.no_grad():
            known = layer.known(torch.cat((context.prior.mean, context.h), dim=-1)) + layer.sample.bias
            edges = torch.stack(layer.net.prepare(context.relative), dim=1)
        drawn = context.drawn.numpy()
        return CoupledScenes(
            self._weights,
            self._graph,
            {k: array_of(known) + code for k, code in self._codes.items()},
            array_of(edges),
            drawn,
            np.where(drawn, 0.0, ABSENT).astype(self._weights.out.dtype),
            array_of(context.h),
        )


class CoupledScenes(NamedTuple):
    """The coupling of B scenes.

    Attributes:
        weights: of the coupling.
        graph: of its layers.
        known: step → (B, A, M) what is known without the noisy latents.
        edges: (B, L, A, A, M) what relative poses add to messages.
        drawn: (B, A) whose latents mean something.
        attention_bias: (B, A) added to the scores of senders: very negative where nobody is drawn.
        h: (B, A, D) embeddings.
    """

    weights: CouplingWeights
    graph: GraphWeights
    known: dict[int, Array]
    edges: Array
    drawn: BoolArray
    attention_bias: Array
    h: Array

    def states(self, x: Array, k: int) -> Array:
        """Return embeddings (B, A, D) that know of all noisy latents *x* (B, A, C, L) at step *k*."""
        latents = x.reshape(*x.shape[:2], -1)
        embeddings = np.empty_like(self.h)
        for b, edges in enumerate(self.edges):
            begin, activations = self.known[k][b].copy(), room(self.graph, edges)
            given = latents[b], begin, self.attention_bias[b], self.drawn[b], activations, self.h[b]
            embeddings[b] = couple(self.weights, self.graph, *given)
        return embeddings
