"""The decoder at run time on the CPU, for tensors: whole scenes, and some of their rows with gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.diffusion.compiled.backward import roll_back
from advdiff_sumo.diffusion.compiled.kernel import Array, array_of
from advdiff_sumo.diffusion.compiled.records import Tape
from advdiff_sumo.diffusion.compiled.records import Trace as SceneTrace
from advdiff_sumo.diffusion.compiled.rollout import roll
from advdiff_sumo.diffusion.compiled.vehicle_kernel import DONE, cars_of
from advdiff_sumo.diffusion.compiled.weights import edge_weights_of, graph_weights, roll_weights
from advdiff_sumo.diffusion.trace import Trace
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Decoder, Rollout
from advdiff_sumo.models.interaction import ABSENT


class CompiledDecoder:
    """Rolls out scenes on the CPU, one after the other.

    Args:
        decoder: the trained network; its weights are read when this is made.
    """

    def __init__(self, decoder: Decoder) -> None:
        self.options = decoder.options
        self.weights = roll_weights(decoder)
        self.edge_weights = edge_weights_of(decoder)
        self.graph = graph_weights(decoder.interaction.in_order())

    def whole(self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int) -> tuple[Rollout, Trace]:
        """Return the futures of all agents and their trace; as :meth:`FastDecoder.whole`."""
        scenes, agents = z.shape[:2]
        rows = np.arange(agents)
        layers, _, wide = self.edge_weights.edge.shape
        futures = self._blank(scenes, steps, agents, 6)
        motion, senders = (
            self._blank(scenes, steps, agents, 4),
            self._blank(scenes, steps, layers, agents, wide),
        )
        tape, cars, attention_bias = (
            self.tape(1, agents, agents),
            self.cars(batch),
            attention_biases(batch, futures),
        )
        latents, known = array_of(z), array_of(h)
        for b in range(scenes):
            trace = SceneTrace(motion[b], senders[b])
            given = latents[b], known[b], cars[b], rows, attention_bias[b]
            roll(self.weights, self.edge_weights, self.graph, *given, trace, False, tape, futures[b])
        swapped = Trace(torch.from_numpy(motion).transpose(0, 1), torch.from_numpy(senders).movedim(0, 2))
        return rollout_of(futures), swapped

    def some(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> Rollout:
        """Return the futures of *rows*, with gradients to *z*; as :meth:`FastDecoder.some`."""
        run = RowsAgainst(self, h, batch, rows, steps, trace)
        return Rollout(*_Function.apply(z, run))  # type: ignore[no-untyped-call] # PyTorch's

    def cars(self, batch: SceneBatch) -> Array:
        """Return (B, A, 6) the vehicles of *batch*."""
        pose = array_of(batch.pose)
        length, moved = batch.size[..., 0].numpy().ravel(), batch.moved.numpy().ravel()
        cars = cars_of(pose.reshape(-1, 4), length, moved, self.options)
        return cars.reshape(*pose.shape[:2], -1)

    def tape(self, slots: int, count: int, agents: int) -> Tape:
        """Return room for what roll-outs of *count* vehicles among *agents* leave."""
        width, inner = self.weights.start_h.shape[1], self.graph.first.shape[2]
        layers, heads, wide = self.graph.score.shape
        each = (slots, layers, count)
        return Tape(
            first=self._blank(count, width),
            memory=self._blank(slots, count, width),
            from_memory=self._blank(slots, count, 4 * width),
            node=self._blank(slots, count, width),
            hidden=self._blank(slots, count, width),
            gates=self._blank(slots, count, 3 * width),
            driven=self._blank(slots, count, DONE),
            message=self._blank(*each, agents, wide),
            weight=self._blank(*each, heads, agents),
            normal=self._blank(*each, width),
            deviation=self._blank(*each),
            inner=self._blank(*each, inner),
        )

    def _blank(self, *shape: int) -> Array:
        return np.empty(shape, self.weights.limits.dtype)


class RowsAgainst:
    """Roll-outs of some rows against a trace, and their gradients; the tape is of the last one.

    Args:
        decoder: the networks.
        h: (B, A, D) embeddings of all.
        batch: the scenes.
        rows: (R,) agents, the same in every scene.
        steps: model steps, at most those of the trace.
        trace: of the whole scenes.
    """

    def __init__(
        self, decoder: CompiledDecoder, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> None:
        self.decoder, self.rows, self.steps = decoder, rows.numpy(), steps
        self.h, self.cars = array_of(h[:, rows]), decoder.cars(batch.rows_of(rows))
        self.attention_bias = attention_biases(batch, self.h)
        self.traces = [
            SceneTrace(array_of(trace.motion[:, b]), array_of(trace.senders[:, :, b]))
            for b in range(batch.scenes)
        ]
        self.tapes = [decoder.tape(steps, len(self.rows), batch.agents) for _ in self.traces]

    def forward(self, latents: Array) -> Array:
        """Return (B, T, R, 6) what *latents* (B, R, Z) lead to."""
        futures = np.empty((len(latents), self.steps, len(self.rows), 6), latents.dtype)
        networks = self.decoder.weights, self.decoder.edge_weights, self.decoder.graph
        for b, trace in enumerate(self.traces):
            given = latents[b], self.h[b], self.cars[b], self.rows, self.attention_bias[b]
            roll(*networks, *given, trace, True, self.tapes[b], futures[b])
        return futures

    def back(self, grad: Array) -> Array:
        """Return the gradient (B, R, Z) of latents for that, *grad* (B, T, R, 6), of what they lead to."""
        weights, graph = self.decoder.weights, self.decoder.graph
        gradients = [
            roll_back(weights, graph, self.cars[b], self.rows, tape, grad[b])
            for b, tape in enumerate(self.tapes)
        ]
        return np.stack(gradients)


class _Function(torch.autograd.Function):
    """Autograd's view of :class:`RowsAgainst`."""

    @staticmethod
    def forward(ctx: Any, z: Tensor, run: RowsAgainst) -> tuple[Tensor, ...]:
        ctx.run = run
        rollout = rollout_of(run.forward(array_of(z)))
        return rollout.xy, rollout.yaw, rollout.speed, rollout.accel, rollout.curvature

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        parts = [part.numpy() for part in grads]
        every = np.concatenate((parts[0], np.stack(parts[1:], axis=-1)), axis=-1)  # (B, R, T, 6)
        return torch.from_numpy(ctx.run.back(np.ascontiguousarray(every.swapaxes(1, 2)))), None


def attention_biases(batch: SceneBatch, like: Array) -> Array:
    """Return (B, A) what is added to the scores of senders: very negative where nobody is."""
    return np.where(batch.present.numpy(), 0.0, ABSENT).astype(like.dtype)


def rollout_of(futures: Array) -> Rollout:
    """Return *futures* (B, T, A, 6) as futures."""
    parts = torch.from_numpy(np.ascontiguousarray(futures.transpose(3, 0, 2, 1)))  # (6, B, A, T)
    return Rollout(torch.stack((parts[0], parts[1]), dim=-1), *parts[2:].unbind())
