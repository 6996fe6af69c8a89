"""The decoder for run time: the same network as ``models.decoder``, equal up to rounding, in fewer operations.

It can also roll out a few rows of a scene against the rest of an earlier rollout, which is what guidance needs:
the gradient for one or two attackers then costs a fraction of that for the whole scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor, nn
from torch.nn.functional import layer_norm, linear

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bicycle import controls, step
from advdiff_sumo.models.decoder import Decoder, Rollout
from advdiff_sumo.models.geometry import RELATIVE_FEATURES
from advdiff_sumo.models.interaction import InteractionLayer
from advdiff_sumo.models.options import FUTURE_STEPS, MODEL_STEP_S

_Motion: TypeAlias = tuple[Tensor, Tensor, Tensor]  # xy (B, A, 2), yaw (B, A), speed (B, A)
_NEAR = 2  # column of relative_features: compressed distance
_PLANES = (
    (0, 1),
    (3, 4),
    (5, 6),
)  # columns that are vectors in the receiver's frame: place, heading, velocity
_AHEAD_SPEED, _OWN_SPEED = 7, 8
_PLACE_SCALE, _SPEED_SCALE = 0.05, 0.1


@dataclass(frozen=True)
class Trace:
    """What a rollout of a whole scene leaves for rollouts of some of its rows.

    Attributes:
        edges: for each step and layer, what relative poses add to the messages, (B, A, A, M).
        senders: for each step and layer, what everybody says to the others, (B, A, M).
    """

    edges: tuple[tuple[Tensor, ...], ...]
    senders: tuple[tuple[Tensor, ...], ...]

    def repeat(self, times: int) -> Trace:
        """Return the trace of the one scene *times* times."""
        edges, senders = (
            tuple(tuple(x.expand(times, *x.shape[1:]) for x in layers) for layers in part)
            for part in (self.edges, self.senders)
        )
        return Trace(edges, senders)


class FastDecoder:
    """Rolls out scenes of one plan.

    Args:
        decoder: the trained network.
    """

    def __init__(self, decoder: Decoder) -> None:
        self._net = decoder
        self._layers = [x for x in decoder.interaction.layers if isinstance(x, InteractionLayer)]
        self._edge = _Edges(decoder)
        width = decoder.options.hidden
        weight = decoder.node.weight.detach()
        latent = decoder.options.latent
        self._node_z = weight[:, width : width + latent]
        self._node_rest = torch.cat((weight[:, :width], weight[:, width + latent :]), dim=1).t().contiguous()

    def whole(
        self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int = FUTURE_STEPS
    ) -> tuple[Rollout, Trace]:
        """Return the futures of all agents, without gradients, and their trace.

        Args:
            z: (B, A, Z) latents.
            h: (B, A, D) embeddings.
            batch: the scenes.
            steps: model steps to roll out.
        """
        with torch.no_grad():
            return self._roll(z, h, batch, torch.arange(batch.agents, device=z.device), steps, None)

    def some(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> Rollout:
        """Return the futures (B, R, …) of agents *rows* alone, the others as in *trace*; gradients flow to *z*.

        What the rows see of each other and of the others is that of the trace too, so the result is exact at the
        latents of the trace, and its gradient lacks what a changed place would change in the interaction.

        Args:
            z: (B, R, Z) latents of the rows.
            h: (B, A, D) embeddings of all.
            batch: the scenes.
            rows: (R,) agents, the same in every scene.
            steps: model steps, at most those of the trace.
            trace: of the whole scene.
        """
        return self._roll(z, h, batch, rows, steps, trace)[0]

    def _roll(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace | None
    ) -> tuple[Rollout, Trace]:
        net = self._net
        pose, length, moved = batch.pose[:, rows], batch.size[:, rows, 0], batch.moved[:, rows].to(z.dtype)
        memory = torch.tanh(net.start(torch.cat((h[:, rows], z), dim=-1)))
        given = linear(z, self._node_z, net.node.bias)
        blocked = (
            None if bool(batch.present.all()) else torch.where(batch.present, 0.0, -1e9)[:, None, :, None]
        )
        motion: _Motion = pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)
        states, seen, senders = [], [], []
        for k in range(steps):
            edges = self._edge.of(motion) if trace is None else tuple(x[:, rows] for x in trace.edges[k])
            node = self._node(memory, given, pose, motion)
            others = None if trace is None else trace.senders[k]
            mixed, said = self._mix(node, edges, rows, others, blocked)
            accel, curvature = controls(net.action(mixed), motion[2], length, net.options)
            accel, curvature = accel * moved, curvature * moved
            seen.append(edges)
            senders.append(said)
            motion = step(*motion, accel, curvature, MODEL_STEP_S)
            memory = self._remember(mixed, accel, curvature, memory)
            states.append((*motion, accel, curvature))
        rollout = Rollout(*(torch.stack(column, dim=2) for column in zip(*states, strict=True)))
        return rollout, Trace(tuple(seen), tuple(senders))

    def _node(self, memory: Tensor, given: Tensor, pose: Tensor, motion: _Motion) -> Tensor:
        xy, yaw, speed = motion
        cos, sin = torch.cos(pose[..., 2]), torch.sin(pose[..., 2])
        east, north = (_PLACE_SCALE * (xy - pose[..., :2])).unbind(-1)
        turn = yaw - pose[..., 2]
        columns = (
            cos * east + sin * north,
            cos * north - sin * east,
            torch.cos(turn),
            torch.sin(turn),
            _SPEED_SCALE * speed,
            _SPEED_SCALE * (speed - pose[..., 3]),
        )
        known = torch.cat((memory, torch.stack(columns, dim=-1)), dim=-1)
        return torch.relu(given + known @ self._node_rest)

    def _mix(
        self,
        h: Tensor,
        edges: tuple[Tensor, ...],
        rows: Tensor,
        others: tuple[Tensor, ...] | None,
        blocked: Tensor | None,
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return the rows' embeddings after the interaction net, and what everybody sent in each layer."""
        senders = []
        for number, layer in enumerate(self._layers):
            sent = layer.sender(h)
            sent = sent if others is None else others[number].index_copy(1, rows, sent)
            senders.append(sent)
            h = _layer(layer, h, edges[number], sent, blocked)
        return h, tuple(senders)

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
        net = decoder.interaction.edges.net
        first, second = net[0], net[2]
        assert isinstance(first, nn.Linear)  # noqa: S101 - tells the type checker what stands there
        assert isinstance(second, nn.Linear)  # noqa: S101 - the same
        weight = first.weight.detach().t().clone()  # (9, E)
        assert len(weight) == RELATIVE_FEATURES  # noqa: S101 - the columns named above are those
        own = weight[_OWN_SPEED] - weight[_AHEAD_SPEED]
        weight[_PLANES[2][0]] += weight[_AHEAD_SPEED]
        plane = torch.stack([weight[list(pair)] for pair in _PLANES])  # (3, 2, E)
        scale = torch.tensor((_PLACE_SCALE, 1.0, _SPEED_SCALE), device=plane.device, dtype=plane.dtype)
        plane = plane * scale[:, None, None]
        self._straight = plane.flatten(0, 1)
        self._turned = torch.stack((-plane[:, 1], plane[:, 0]), dim=1).flatten(0, 1)
        self._near, self._own = weight[_NEAR], _SPEED_SCALE * own
        self._bias = first.bias.detach()
        self._second = second
        self._layers = [x.edge for x in decoder.interaction.layers if isinstance(x, InteractionLayer)]

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
