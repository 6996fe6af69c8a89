"""The reward model for run time: Q of many actions in one state, with the gradient of the action by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.graph_layer import Activations, GraphLayer
from advdiff_sumo.models.interaction import ABSENT, InteractionLayer
from advdiff_sumo.models.reward import RewardModel, RewardState


@dataclass(frozen=True)
class _Pass:
    """What the gradient needs: both hidden embeddings (G, R), the layers', and the value's hidden part (B, R)."""

    first: Tensor
    second: Tensor
    activations: Any
    hidden: Tensor


class RewardWeights:
    """The weights of a reward model, in the order in which :class:`FastReward` multiplies by them.

    Args:
        model: the trained network; its weights are read when this is made.
        compiled: let compiled loops mix the agents; None: where the network is on the CPU.
    """

    def __init__(self, model: RewardModel, compiled: bool | None = None) -> None:
        self.action = model.action.weight.detach()
        self.mix = _affine(model.mix[1])
        self.values = _affine(model.value[0]), _affine(model.value[2])
        here = self.action.device.type == "cpu" if compiled is None else compiled
        self.layers = layers_of(model.interaction.in_order(), here)


class FastReward:
    """Q of one state, the same as ``models.reward`` up to rounding.

    Args:
        weights: of the model.
        state: what of Q does not depend on the action.
    """

    def __init__(self, weights: RewardWeights, state: RewardState) -> None:
        self._shape = state.node.shape[:2]
        self._node = state.node.detach()
        self._action, self._mix, self._values = weights.action, weights.mix, weights.values
        present = state.present
        rows = torch.arange(present.shape[1], device=present.device)
        kind = state.node.dtype
        own = rows == state.target[:, None]
        self._free = (~own & present).to(kind).flatten()[:, None]
        # (B, 2, A): what reads the target's node, and the mean of all
        mean = present.to(kind) / present.sum(1, keepdim=True).clamp(min=1)
        self._read = torch.stack((own.to(kind), mean), dim=1)
        edges = [edge.detach() for edge in state.edges]
        self._layers = weights.layers(edges, torch.where(present, 0.0, ABSENT).to(kind))

    def __call__(self, mu: Tensor) -> Tensor:
        """Return Q (B,) of actions *mu* (B, A, Z), with gradients to them."""
        value: Tensor = _Function.apply(mu, self)  # type: ignore[no-untyped-call] # PyTorch's
        return value

    @torch.no_grad()
    def slope(self, mu: Tensor) -> Tensor:
        """Return the gradient (B, A, Z) of the sum of Q for actions *mu* (B, A, Z)."""
        value, done = self.value(mu)
        return self.back(torch.ones_like(value), done)

    def value(self, mu: Tensor) -> tuple[Tensor, _Pass]:
        """Return Q (B,) and what :meth:`back` needs."""
        scenes, agents = self._shape
        node = torch.mm(mu.flatten(0, 1), self._action.t()).mul_(self._free)
        first = node.add_(self._node.flatten(0, 1)).relu_()
        second = torch.addmm(self._mix[1], first, self._mix[0].t()).relu_()
        h, kept = self._layers.forward(second.reshape(scenes, agents, -1))
        read = torch.bmm(self._read, h).flatten(1)
        (weight, bias), (last, offset) = self._values
        hidden = torch.addmm(bias, read, weight.t()).relu_()
        return torch.addmm(offset, hidden, last.t())[:, 0], _Pass(first, second, kept, hidden)

    def back(self, grad: Tensor, done: _Pass) -> Tensor:
        """Return the gradient (B, A, Z) of actions for gradients (B,) of their values."""
        scenes, agents = self._shape
        (weight, _), (last, _) = self._values
        read = torch.mm((grad[:, None] * last) * (done.hidden > 0.0), weight)
        node = torch.bmm(self._read.transpose(1, 2), read.reshape(scenes, 2, -1))
        node = self._layers.back(node, done.activations).flatten(0, 1)
        second = torch.mm(node * (done.second > 0.0), self._mix[0])
        first = second * (done.first > 0.0) * self._free
        return torch.mm(first, self._action).reshape(scenes, agents, -1)


class _Function(torch.autograd.Function):
    """Autograd's view of :class:`FastReward`."""

    @staticmethod
    def forward(ctx: Any, mu: Tensor, model: FastReward) -> Tensor:
        value, ctx.done = model.value(mu.detach())
        ctx.model = model
        return value

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        return ctx.model.back(grad, ctx.done), None


class _Layers(Protocol):
    """Interaction layers with their gradient."""

    def forward(self, h: Tensor) -> tuple[Tensor, Any]:
        """Return new embeddings (B, A, D) of *h*, and what :meth:`back` needs."""

    def back(self, grad: Tensor, kept: Any) -> Tensor:
        """Return the gradient (B, A, D) of the embeddings for that of the new ones."""


class TensorLayers:
    """Layers on tensors of any device; arguments are those of :class:`CompiledLayers`."""

    def __init__(self, layers: Sequence[GraphLayer], edges: Sequence[Tensor], attention_bias: Tensor) -> None:
        self._layers, self._edges = layers, edges
        self._attention_bias = attention_bias.repeat_interleave(attention_bias.shape[1], dim=0)

    def forward(self, h: Tensor) -> tuple[Tensor, list[Activations]]:
        """Return new embeddings (B, A, D) of *h*, and what :meth:`back` needs."""
        scenes, agents = h.shape[:2]
        node, kept = h.flatten(0, 1), []
        for layer, edges in zip(self._layers, self._edges, strict=True):
            receiver, sender = layer.ends(node)
            message = edges + receiver.reshape(scenes, agents, 1, -1)
            message += sender.reshape(scenes, 1, agents, -1)
            node, activations = layer.forward(node, message.flatten(0, 1), self._attention_bias)
            kept.append(activations)
        return node.reshape(scenes, agents, -1), kept

    def back(self, grad: Tensor, kept: list[Activations]) -> Tensor:
        """Return the gradient (B, A, D) of the embeddings for that of the new ones."""
        scenes, agents = grad.shape[:2]
        node = grad.flatten(0, 1)
        for layer, activations in zip(reversed(self._layers), reversed(kept), strict=True):
            past, message = layer.back(node, activations)
            sender = message.reshape(scenes, agents, agents, -1).sum(1).flatten(0, 1)
            node = past + layer.back_ends(message.sum(1), sender)
        return node.reshape(scenes, agents, -1)


def layers_of(
    layers: Sequence[InteractionLayer], compiled: bool
) -> Callable[[Sequence[Tensor], Tensor], _Layers]:
    """Return the layers, on tensors or compiled, as a function of edges and what is added to scores."""
    if not compiled:
        return partial(TensorLayers, [GraphLayer(layer) for layer in layers])
    from advdiff_sumo.diffusion.compiled.layers import CompiledLayers
    from advdiff_sumo.diffusion.compiled.weights import graph_weights

    return partial(CompiledLayers, graph_weights(layers))


def _affine(layer: nn.Module) -> tuple[Tensor, Tensor]:
    assert isinstance(layer, nn.Linear)  # noqa: S101 - tells the type checker what stands there
    return layer.weight.detach(), layer.bias.detach()
