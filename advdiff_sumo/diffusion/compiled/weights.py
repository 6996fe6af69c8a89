"""Weights in the order in which the compiled loops multiply by them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.compiled.kernel import Array, array_of
from advdiff_sumo.diffusion.compiled.records import EdgeWeights, GraphWeights, RollWeights
from advdiff_sumo.diffusion.compiled.vehicle_kernel import limits_of
from advdiff_sumo.diffusion.decoder_weights import edge_terms
from advdiff_sumo.models.decoder import Decoder
from advdiff_sumo.models.interaction import InteractionLayer

CONTROL_SCALE = (0.25, 10.0)
"""Acceleration and curvature as the decoder's memory reads them."""


def roll_weights(decoder: Decoder) -> RollWeights:
    """Return the weights of *decoder*."""
    width, latent = decoder.options.hidden, decoder.options.latent
    start, node, cell = decoder.start, decoder.node, decoder.memory
    first, last = decoder.action[0], decoder.action[2]
    assert isinstance(first, nn.Linear)  # noqa: S101 - tells the type checker what stands there
    assert isinstance(last, nn.Linear)  # noqa: S101 - the same
    start_h, start_z = start.weight[:, :width], start.weight[:, width:]
    node_memory, node_z, motion = torch.split(
        node.weight, [width, latent, node.in_features - width - latent], dim=1
    )
    mixed, controls = cell.weight_ih[:, :width], cell.weight_ih[:, width:]
    controls = controls * torch.tensor(CONTROL_SCALE, dtype=controls.dtype)
    from_memory_bias = torch.cat((torch.zeros_like(node.bias), cell.bias_hh))
    return RollWeights(
        array_of(start_h.t()),
        *_both(start_z),
        array_of(start.bias),
        *_both(node_z),
        array_of(node.bias),
        *_both(torch.cat((node_memory, cell.weight_hh))),
        array_of(from_memory_bias),
        *_both(motion),
        *_both(torch.cat((first.weight, mixed))),
        array_of(torch.cat((first.bias, cell.bias_ih))),
        *_both(last.weight),
        array_of(last.bias),
        *_both(controls),
        limits_of(decoder.options, array_of(node.bias)),
    )


def edge_weights_of(decoder: Decoder) -> EdgeWeights:
    """Return how *decoder* embeds relative poses."""
    terms = edge_terms(decoder)
    edge_features = torch.cat((terms.planes.flatten(0, 1), terms.near[None], terms.own[None]))  # (8, E)
    edge = torch.stack([layer.edge.weight.t() for layer in decoder.interaction.in_order()])
    second = terms.second
    return EdgeWeights(
        array_of(edge_features),
        array_of(terms.bias),
        array_of(second.weight.t()),
        array_of(second.bias),
        array_of(edge),
    )


def _both(weight: Tensor) -> tuple[Array, Array]:
    """Return *weight* (out, in) as it multiplies forward, (in, out), and backward."""
    return array_of(weight.t()), array_of(weight)


def graph_weights(layers: Sequence[InteractionLayer]) -> GraphWeights:
    """Return the weights of *layers*, which are of one size."""
    mix = [(part[0], part[2]) for part in (layer.mix for layer in layers)]

    def both(weights: Sequence[Tensor]) -> tuple[Array, Array]:
        every = torch.stack([weight.detach() for weight in weights])
        return array_of(every.transpose(1, 2)), array_of(every)

    def stacked(parts: Sequence[Tensor]) -> Array:
        return array_of(torch.stack([part.detach() for part in parts]))

    def linear(parts: Sequence[nn.Module]) -> tuple[Array, Array, Array]:
        return (*both([part.weight for part in parts]), stacked([part.bias for part in parts]))  # type: ignore[misc] # all are linear

    ends = both([torch.cat((layer.receiver.weight, layer.sender.weight)) for layer in layers])
    bias = stacked([torch.cat((x, torch.zeros_like(x))) for x in (layer.receiver.bias for layer in layers)])
    return GraphWeights(
        *ends,
        bias,
        stacked([layer.score.weight for layer in layers]),
        *linear([layer.out for layer in layers]),
        stacked([layer.norm.weight for layer in layers]),
        stacked([layer.norm.bias for layer in layers]),
        np.array([layer.norm.eps for layer in layers], dtype=bias.dtype),
        *linear([first for first, _ in mix]),
        *linear([second for _, second in mix]),
    )
