"""The decoder's weights in the order in which the run-time form multiplies by them, and how edges are embedded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.bicycle_arrays import Array, blank
from advdiff_sumo.diffusion.graph_layer import GraphLayer
from advdiff_sumo.models.decoder import Decoder
from advdiff_sumo.models.geometry import RELATIVE_FEATURES
from advdiff_sumo.models.interaction import InteractionLayer

NEAR = 2
"""Column of ``relative_features``: compressed distance."""
PLANES = ((0, 1), (3, 4), (5, 6))
"""Columns that are vectors in the receiver's frame: place, heading, velocity."""
AHEAD_SPEED, OWN_SPEED = 7, 8
PLACE_SCALE, SPEED_SCALE = 0.05, 0.1
CONTROL_SCALE = (0.25, 10.0)
"""Acceleration and curvature as the decoder's memory reads them."""


def graph_layers(decoder: Decoder) -> list[InteractionLayer]:
    """Return the decoder's interaction layers."""
    return [x for x in decoder.interaction.layers if isinstance(x, InteractionLayer)]


class DecoderWeights:
    """Weights of one decoder, (out, in) each, side by side where they multiply the same.

    Attributes:
        width: D.
        start_h, start_z, start_bias: the first memory.
        node_z, node_bias: of the latent in the node.
        held, held_bias: what is made of the memory: the node's part (D), then the gates' (3 D).
        motion: of the features of the own motion in the node.
        told, told_bias: what is made of the mixed node: the action's hidden part (D), then the gates' (3 D).
        act, act_bias: the action's last product.
        done: of both controls in the gates.
        layers: interaction layers.
    """

    def __init__(self, decoder: Decoder) -> None:
        width, latent = decoder.options.hidden, decoder.options.latent
        start, node, cell = decoder.start, decoder.node, decoder.memory
        first, last = decoder.action[0], decoder.action[2]
        assert isinstance(first, nn.Linear)  # noqa: S101 - tells the type checker what stands there
        assert isinstance(last, nn.Linear)  # noqa: S101 - the same
        self.width = width
        self.start_h, self.start_z = torch.split(start.weight.detach(), [width, latent], dim=1)
        self.start_bias = start.bias.detach()
        by_memory, self.node_z, self.motion = torch.split(
            node.weight.detach(), [width, latent, node.in_features - width - latent], dim=1
        )
        self.node_bias = node.bias.detach()
        by_mixed, self.done = torch.split(cell.weight_ih.detach(), [width, cell.input_size - width], dim=1)
        self.held = torch.cat((by_memory, cell.weight_hh.detach()))
        self.held_bias = torch.cat((torch.zeros_like(self.node_bias), cell.bias_hh.detach()))
        self.told = torch.cat((first.weight.detach(), by_mixed))
        self.told_bias = torch.cat((first.bias.detach(), cell.bias_ih.detach()))
        self.act, self.act_bias = last.weight.detach(), last.bias.detach()
        self.layers = [GraphLayer(layer) for layer in graph_layers(decoder)]
        # views of the same, (in, out), for the way forward
        self.held_t, self.told_t, self.done_t = self.held.t(), self.told.t(), self.done.t()
        self.motion_t, self.act_t = self.motion.t(), self.act.t()


@dataclass(frozen=True)
class EdgeTerms:
    """The edge encoder's first layer by what it multiplies, and its second; all but one column are products.

    Attributes:
        planes: (3, 2, E) of the vectors in the receiver's frame, scaled: place, heading, velocity.
        near: (E,) of the compressed distance.
        own: (E,) of the receiver's speed, scaled.
        bias: (E,) of the first layer.
        second: the second layer.
    """

    planes: Tensor
    near: Tensor
    own: Tensor
    bias: Tensor
    second: nn.Linear


def edge_terms(decoder: Decoder) -> EdgeTerms:
    """Return the terms of *decoder*'s edge encoder."""
    first, second = decoder.interaction.edges.net[0], decoder.interaction.edges.net[2]
    assert isinstance(first, nn.Linear)  # noqa: S101 - tells the type checker what stands there
    assert isinstance(second, nn.Linear)  # noqa: S101 - the same
    weight = first.weight.detach().t().clone()  # (9, E)
    assert len(weight) == RELATIVE_FEATURES  # noqa: S101 - the columns named above are those
    own = weight[OWN_SPEED] - weight[AHEAD_SPEED]
    weight[PLANES[2][0]] += weight[AHEAD_SPEED]
    scales = (PLACE_SCALE, 1.0, SPEED_SCALE)
    planes = [scale * weight[list(pair)] for scale, pair in zip(scales, PLANES, strict=True)]
    return EdgeTerms(torch.stack(planes), weight[NEAR], SPEED_SCALE * own, first.bias.detach(), second)


class EdgeWeights:
    """Embeds relative poses; the three vectors in the receiver's frame are products of complex numbers.

    Args:
        decoder: the trained network.
    """

    def __init__(self, decoder: Decoder) -> None:
        terms = edge_terms(decoder)
        self._first = torch.cat((terms.planes.flatten(0, 1), terms.near[None], terms.own[None]))  # (8, E)
        self._second = terms.second.weight.detach().t()
        self._bias = terms.bias, terms.second.bias.detach()
        self._layers = [layer.edge.weight.detach().t() for layer in graph_layers(decoder)]

    def of(self, x: Array, y: Array, yaw: Array, speed: Array, rows: Array | None = None) -> list[Tensor]:
        """Return for each layer what agents (S, A) look like to *rows* of them, or to all: (S, R, A, M)."""
        turned = np.empty((*yaw.shape, 2), yaw.dtype)
        turned[..., 0], turned[..., 1] = np.cos(yaw), np.sin(yaw)
        place = np.empty_like(turned)
        place[..., 0], place[..., 1] = x, y
        kind = np.result_type(yaw.dtype, np.complex64)
        heading, where = turned.view(kind)[..., 0], place.view(kind)[..., 0]  # (S, A)
        pick = slice(None) if rows is None else rows
        back, here = heading[:, pick, None].conj(), where[:, pick, None]
        seen = blank((*back.shape[:2], yaw.shape[1], 8), yaw)
        vectors, delta = seen.view(kind), where[:, None] - here
        np.multiply(delta, back, out=vectors[..., 0])
        course = heading[:, None] * back
        vectors[..., 1] = course
        np.multiply(course, speed[:, None], out=vectors[..., 2])
        squared = delta.real**2 + delta.imag**2
        seen[..., 6] = np.exp(-0.1 * np.sqrt(squared + 1e-6))
        seen[..., 7] = speed[:, pick, None]
        flat = torch.from_numpy(seen.reshape(-1, 8))
        hidden = torch.addmm(self._bias[0], flat, self._first).relu_()
        hidden = torch.addmm(self._bias[1], hidden, self._second).relu_()
        return [torch.mm(hidden, layer).reshape(*seen.shape[:3], -1) for layer in self._layers]
