"""Interaction net: fully connected graph layers over the agents of a scene (Sec. III-B)."""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import Tensor, nn

from advdiff_sumo.models.geometry import RELATIVE_FEATURES
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.perceptron import perceptron

ABSENT = -1e9
"""Attention score of absent senders."""


class InteractionLayer(nn.Module):
    """One graph layer: each agent attends to messages computed from sender, receiver and their relative pose."""

    def __init__(self, width: int, edge: int, message: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.receiver = nn.Linear(width, message)
        self.sender = nn.Linear(width, message, bias=False)
        self.edge = nn.Linear(edge, message, bias=False)
        self.score = nn.Linear(message, heads, bias=False)
        self.out = nn.Linear(message, width)
        self.norm = nn.LayerNorm(width)
        self.mix = perceptron(width, width, width)

    def forward(self, h: Tensor, edges: Tensor, mask: Tensor) -> Tensor:
        """Return new embeddings (B, A, D) of agents *h* (B, A, D); 0 outside *mask* (B, A).

        *edges* (B, A, A, M) are the contributions of relative poses to the messages, from :attr:`edge`.
        """
        return self.receive(h, edges, self.sender(h)[:, None], mask[:, None]) * mask[..., None]

    def receive(self, h: Tensor, edges: Tensor, sent: Tensor, mask: Tensor) -> Tensor:
        """Return new embeddings (B, R, D) of R receivers, with K senders each.

        Args:
            h: (B, R, D) embeddings of the receivers.
            edges: (B, R, K, M) contributions of relative poses to the messages, from :attr:`edge`.
            sent: (B, R or 1, K, M) contributions of the senders to the messages, from :attr:`sender`.
            mask: (B, R or 1, K) which senders are present.
        """
        message = torch.relu_(edges + self.receiver(h)[:, :, None] + sent)
        score = self.score(message).masked_fill(~mask[..., None], ABSENT)
        weight = torch.softmax(score, dim=2) * mask[..., None]
        split = message.reshape(*message.shape[:-1], self.heads, -1)
        gathered = (weight[..., None] * split).sum(2).flatten(-2)
        mixed = self.norm(h + self.out(gathered))
        new: Tensor = mixed + self.mix(mixed)
        return new


class InteractionNet(nn.Module):
    """A stack of graph layers with shared embeddings of relative poses.

    Args:
        width: of the embeddings.
        options: widths of edges and messages, heads.
        layers: their number; None: as the options say.
    """

    def __init__(self, width: int, options: ModelOptions, layers: int | None = None) -> None:
        super().__init__()
        count = options.interaction_layers if layers is None else layers
        net = perceptron(RELATIVE_FEATURES, options.edge, options.edge, ends_in_relu=True)
        self.edges = nn.Sequential(OrderedDict(net=net))  # weights are stored under this name
        self.layers = nn.ModuleList(
            InteractionLayer(width, options.edge, options.message, options.heads) for _ in range(count)
        )

    def forward(self, h: Tensor, relative: Tensor, mask: Tensor) -> Tensor:
        """Return embeddings *h* (B, A, D) after the exchange of messages, for *relative* poses (B, A, A, 9).

        Agents outside *mask* (B, A) neither send nor receive.
        """
        return self.mix(h, self.prepare(relative), mask)

    def prepare(self, relative: Tensor) -> list[Tensor]:
        """Return, for each layer, the contributions of *relative* poses (B, A, A, 9) to the messages."""
        edges = self.edges(relative)
        return [layer.edge(edges) for layer in self.in_order()]

    def mix(self, h: Tensor, edges: list[Tensor], mask: Tensor) -> Tensor:
        """Return :meth:`forward` of embeddings *h* (B, A, D), with *edges* of :meth:`prepare`."""
        for layer, edge in zip(self.in_order(), edges, strict=True):
            h = layer(h, edge, mask)
        return h

    def in_order(self) -> list[InteractionLayer]:
        """Return the layers in order."""
        return [layer for layer in self.layers if isinstance(layer, InteractionLayer)]
