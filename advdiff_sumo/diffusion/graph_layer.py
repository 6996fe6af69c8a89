"""One interaction layer with its gradient written by hand, for the CPU.

The same function as ``models.interaction.InteractionLayer``, equal up to rounding: both ends of a message in one
product, scores and sums of heads as products too. For a few dozen vehicles most of autograd's time goes into
bookkeeping; :meth:`GraphLayer.back` does without.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.interaction import InteractionLayer


@dataclass(frozen=True)
class Activations:
    """What of a layer's pass its gradient needs; G = B R receivers, A senders.

    Attributes:
        message: (G, A, M) after the ReLU.
        weight: (G, H, A) attention.
        before: (G, D) the input of the norm.
        statistics: (G, 1) mean and inverse deviation of the norm.
        hidden: (G, D) inside the last two products.
    """

    message: Tensor
    weight: Tensor
    before: Tensor
    statistics: tuple[Tensor, Tensor]
    hidden: Tensor


class GraphLayer:
    """A trained interaction layer; its weights are read when this is made.

    Args:
        layer: the layer.
    """

    def __init__(self, layer: InteractionLayer) -> None:
        first, second = layer.mix[0], layer.mix[2]
        bias = layer.receiver.bias.detach()
        self.heads, self.width = layer.heads, len(bias)
        self._norm = layer.norm.weight.detach(), layer.norm.bias.detach(), layer.norm.eps
        self._ends = torch.cat((layer.receiver.weight.detach(), layer.sender.weight.detach()))
        self._ends_bias = torch.cat((bias, torch.zeros_like(bias)))
        self._score = layer.score.weight.detach()
        self._out = layer.out.weight.detach(), layer.out.bias.detach()
        self._first, self._second = (
            (part.weight.detach(), part.bias.detach())  # type: ignore[operator] # both are linear
            for part in (first, second)
        )
        # views, (in, out), for the way forward
        self._ends_t, self._out_t = self._ends.t(), self._out[0].t()
        self._first_t, self._second_t = self._first[0].t(), self._second[0].t()
        own = torch.arange(self.heads).repeat_interleave(self.width // self.heads)
        self._own = (torch.arange(self.heads)[:, None] == own).to(
            bias
        )  # (H, M) which head reads which column

    def ends(self, h: Tensor) -> tuple[Tensor, Tensor]:
        """Return what agents *h* (G, D) add to messages as receivers and as senders, each (G, M)."""
        projected = torch.addmm(self._ends_bias, h, self._ends_t)
        return projected[:, : self.width], projected[:, self.width :]

    def forward(self, h: Tensor, message: Tensor, blocked: Tensor | None) -> tuple[Tensor, Activations]:
        """Return new embeddings (G, D), and what :meth:`back` needs.

        Args:
            h: (G, D) embeddings of the receivers.
            message: (G, A, M) sums of both ends and the edges; overwritten.
            blocked: (G, A) added to the scores, very negative where nobody is; None: all are there.
        """
        receivers, senders, width = message.shape
        message.relu_()
        score = torch.mm(self._score, message.reshape(-1, width).t()).reshape(-1, receivers, senders)
        weight = torch.softmax(score if blocked is None else score + blocked, dim=-1).transpose(0, 1)
        heads = torch.bmm(weight, message)  # (G, H, M): of each head the own columns count
        gathered = (heads * self._own).sum(1)
        before = torch.addmm(self._out[1], gathered, self._out_t).add_(h)
        scale, shift, eps = self._norm
        mixed, *statistics = torch.native_layer_norm(before, scale.shape, scale, shift, eps)
        hidden = torch.addmm(self._first[1], mixed, self._first_t).relu_()
        new = torch.addmm(self._second[1], hidden, self._second_t).add_(mixed)
        return new, Activations(message, weight, before, (statistics[0], statistics[1]), hidden)

    def back(self, grad: Tensor, activations: Activations) -> tuple[Tensor, Tensor]:
        """Return the gradients of the embeddings as they go past the messages (G, D), and of the messages.

        Args:
            grad: (G, D) gradient of the new embeddings.
            activations: of the forward pass.
        """
        hidden = torch.mm(grad, self._second[0]) * (activations.hidden > 0.0)
        mixed = torch.addmm(grad, hidden, self._first[0])
        scale, shift, _ = self._norm
        before = torch.ops.aten.native_layer_norm_backward(
            mixed,
            activations.before,
            scale.shape,
            *activations.statistics,
            scale,
            shift,
            (True, False, False),
        )[0]
        heads = torch.mm(before, self._out[0])[:, None] * self._own  # (G, H, M)
        weight = torch.bmm(heads, activations.message.transpose(1, 2))  # (G, H, A)
        score = activations.weight * (weight - (activations.weight * weight).sum(-1, keepdim=True))
        message = torch.bmm(activations.weight.transpose(1, 2), heads)
        message += torch.matmul(score.transpose(1, 2), self._score)
        return before, message.mul_(activations.message > 0.0)

    def back_ends(self, receiver: Tensor, sender: Tensor) -> Tensor:
        """Return the gradient (G, D) of :meth:`ends` for gradients (G, M) of both."""
        return torch.mm(torch.cat((receiver, sender), dim=1), self._ends)
