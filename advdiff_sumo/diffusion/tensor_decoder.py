"""The decoder's roll-out on tensors of any device: ``models.decoder`` in fewer operations, equal up to rounding."""

from __future__ import annotations

from typing import TypeAlias

import torch
from torch import Tensor
from torch.nn.functional import layer_norm, linear

from advdiff_sumo.diffusion.decoder_weights import PLACE_SCALE, SPEED_SCALE, edge_terms
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Decoder, Rollout
from advdiff_sumo.models.interaction import ABSENT, InteractionLayer
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.tensor_bicycle import controls, step
from advdiff_sumo.models.trace import Trace

_Motion: TypeAlias = tuple[Tensor, Tensor, Tensor]  # xy (B, A, 2), yaw (B, A), speed (B, A)


class TensorDecoder:
    """Rolls out scenes on the network's device.

    Args:
        decoder: the trained network.
    """

    def __init__(self, decoder: Decoder) -> None:
        self._net = decoder
        self._layers = decoder.interaction.in_order()
        self._edge = _Edges(decoder)
        width = decoder.options.hidden
        weight = decoder.node.weight.detach()
        latent = decoder.options.latent
        self._node_z = weight[:, width : width + latent]
        self._node_rest = torch.cat((weight[:, :width], weight[:, width + latent :]), dim=1).t().contiguous()

    def whole(self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int) -> tuple[Rollout, Trace]:
        """Return the futures of all agents, without gradients, and their trace; as :meth:`FastDecoder.whole`."""
        with torch.no_grad():
            return self._roll(z, h, batch, torch.arange(batch.agents, device=z.device), steps, None)

    def some(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> Rollout:
        """Return the futures of *rows*, with gradients to *z*; as :meth:`FastDecoder.some`."""
        return self._roll(z, h, batch, rows, steps, trace)[0]

    def _roll(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace | None
    ) -> tuple[Rollout, Trace]:
        net = self._net
        pose, length, moved = batch.pose[:, rows], batch.size[:, rows, 0], batch.moved[:, rows].to(z.dtype)
        memory = torch.tanh(net.start(torch.cat((h[:, rows], z), dim=-1)))
        given = linear(z, self._node_z, net.node.bias)
        blocked = (
            None if bool(batch.present.all()) else torch.where(batch.present, 0.0, ABSENT)[:, None, :, None]
        )
        motion: _Motion = pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)
        states, edge_features, senders = [], [], []
        given_edges = None if trace is None else self._of_trace(trace, rows, steps)
        for k in range(steps):
            edges = self._edge.of(motion) if given_edges is None else given_edges[k]
            node = self._node(memory, given, pose, motion)
            others = None if trace is None else trace.senders[k]
            mixed, sent = self._mix(node, edges, rows, others, blocked)
            accel, curvature = controls(net.action(mixed), motion[2], length, net.options)
            accel, curvature = accel * moved, curvature * moved
            edge_features.append(torch.cat((motion[0], motion[1][..., None], motion[2][..., None]), dim=-1))
            senders.append(sent)
            motion = step(*motion, accel, curvature, MODEL_STEP_S)
            memory = self._remember(mixed, accel, curvature, memory)
            states.append((*motion, accel, curvature))
        rollout = Rollout(*(torch.stack(column, dim=2) for column in zip(*states, strict=True)))
        return rollout, Trace(torch.stack(edge_features), torch.stack(senders))

    def _of_trace(self, trace: Trace, rows: Tensor, steps: int) -> list[tuple[Tensor, ...]]:
        """Return for each step and layer what *rows* see, (B, R, A, M)."""
        state = trace.motion[:steps]
        flat = state.flatten(0, 1)
        every = self._edge.of((flat[..., :2], flat[..., 2], flat[..., 3]))
        layers = [x[:, rows].reshape(*state.shape[:2], len(rows), *x.shape[2:]) for x in every]
        return [tuple(layer[k] for layer in layers) for k in range(steps)]

    def _node(self, memory: Tensor, given: Tensor, pose: Tensor, motion: _Motion) -> Tensor:
        xy, yaw, speed = motion
        cos, sin = torch.cos(pose[..., 2]), torch.sin(pose[..., 2])
        east, north = (PLACE_SCALE * (xy - pose[..., :2])).unbind(-1)
        turn = yaw - pose[..., 2]
        columns = (
            cos * east + sin * north,
            cos * north - sin * east,
            torch.cos(turn),
            torch.sin(turn),
            SPEED_SCALE * speed,
            SPEED_SCALE * (speed - pose[..., 3]),
        )
        known = torch.cat((memory, torch.stack(columns, dim=-1)), dim=-1)
        return torch.relu(given + known @ self._node_rest)

    def _mix(
        self,
        h: Tensor,
        edges: tuple[Tensor, ...],
        rows: Tensor,
        others: Tensor | None,
        blocked: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        """Return the rows' embeddings after the interaction net, and what all sent in each layer, (layers, …)."""
        senders = []
        for number, layer in enumerate(self._layers):
            sent = layer.sender(h)
            sent = sent if others is None else others[number].index_copy(1, rows, sent)
            senders.append(sent)
            h = _layer(layer, h, edges[number], sent, blocked)
        return h, torch.stack(senders)

    def _remember(self, mixed: Tensor, accel: Tensor, curvature: Tensor, memory: Tensor) -> Tensor:
        done = torch.stack((0.25 * accel, 10.0 * curvature), dim=-1)
        new: Tensor = self._net.memory(torch.cat((mixed, done), dim=-1).flatten(0, 1), memory.flatten(0, 1))
        return new.reshape(memory.shape)


def _layer(layer: InteractionLayer, h: Tensor, edges: Tensor, sent: Tensor, blocked: Tensor | None) -> Tensor:
    """Return one graph layer's new embeddings (B, R, D) of receivers that hear *sent* (B, A, M)."""
    message = torch.relu(edges + layer.receiver(h)[:, :, None] + sent[:, None])
    score = layer.score(message)
    weight = torch.softmax(score if blocked is None else score + blocked, dim=2)
    split = message.reshape(*message.shape[:-1], layer.heads, -1)
    gathered = (weight[..., None] * split).sum(2).flatten(-2)
    mixed = layer_norm(
        h + layer.out(gathered),
        layer.norm.normalized_shape,
        layer.norm.weight,
        layer.norm.bias,
        layer.norm.eps,
    )
    new: Tensor = mixed + layer.mix(mixed)
    return new


class _Edges:
    """Embeds relative poses without making them: the rotation into each receiver's frame goes into the weights.

    All columns of ``relative_features`` but one are products of a number of the receiver and one of the sender.
    """

    def __init__(self, decoder: Decoder) -> None:
        terms = edge_terms(decoder)
        self._straight = terms.planes.flatten(0, 1)
        self._turned = torch.stack((-terms.planes[:, 1], terms.planes[:, 0]), dim=1).flatten(0, 1)
        self._near, self._own = terms.near, terms.own
        self._bias, self._second = terms.bias, terms.second
        self._layers = [x.edge for x in decoder.interaction.in_order()]

    def of(self, motion: _Motion) -> tuple[Tensor, ...]:
        """Return for each layer what everybody looks like to everybody: (B, A, A, M)."""
        xy, yaw, speed = motion
        ahead = torch.stack((torch.cos(yaw), torch.sin(yaw)), dim=-1)
        sender = torch.cat((xy, ahead, speed[..., None] * ahead), dim=-1)  # (B, A, 6)
        weight = ahead[..., :1, None] * self._straight + ahead[..., 1:, None] * self._turned  # (B, A, 6, E)
        start = self._bias + speed[..., None] * self._own
        start = start - (xy[..., None, :] @ weight[..., :2, :]).squeeze(-2)
        delta = xy[:, None] - xy[:, :, None]
        near = torch.exp(-0.1 * torch.sqrt((delta * delta).sum(-1) + 1e-6))
        raw = sender[:, None] @ weight + (start[:, :, None] + near[..., None] * self._near)
        edges = torch.relu(self._second(torch.relu(raw)))
        return tuple(layer(edges) for layer in self._layers)
