"""The decoder's roll-out on the CPU: products by PyTorch, the rest by NumPy, the gradient written by hand.

Equal to ``models.decoder`` up to rounding. PyTorch's bookkeeping for each of some fifty small operations a step takes
longer than the operations themselves; NumPy's takes a fraction of that, and matrix products stay PyTorch's, so that
the option for its threads holds for all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.diffusion.bicycle_arrays import (
    Array,
    Driven,
    Motion,
    Vehicles,
    blank,
    drive,
    drive_back,
)
from advdiff_sumo.diffusion.decoder_weights import CONTROL_SCALE, DecoderWeights, EdgeWeights
from advdiff_sumo.diffusion.graph_layer import GraphLayer, Heard
from advdiff_sumo.diffusion.trace import Trace
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Decoder, Rollout
from advdiff_sumo.models.options import ModelOptions


@dataclass(frozen=True)
class _Step:
    """One step of a roll-out of G vehicles, as its gradient needs it."""

    memory: Tensor
    node: Tensor
    heard: list[Heard]
    hidden: Tensor
    gates: tuple[Tensor, Tensor]
    new: Tensor
    held: Tensor
    driven: Driven


class ArrayDecoder:
    """Rolls out scenes on the CPU.

    Args:
        decoder: the trained network.
    """

    def __init__(self, decoder: Decoder) -> None:
        self.weights = DecoderWeights(decoder)
        self.edges = EdgeWeights(decoder)
        self.options = decoder.options
        self._scale = np.array(CONTROL_SCALE, dtype=self.weights.act.numpy().dtype)

    def whole(self, z: Tensor, h: Tensor, batch: SceneBatch, steps: int) -> tuple[Rollout, Trace]:
        """Return the futures of all agents and their trace; as :meth:`FastDecoder.whole`."""
        shape = z.shape[:2]
        with torch.inference_mode():
            blocked = _blocked(batch, shape[1])
            seen, senders = [], []

            def hear(node: Tensor, motion: Motion) -> tuple[Tensor, list[Heard]]:
                state = [part.reshape(shape) for part in (motion.x, motion.y, motion.yaw, motion.speed)]
                seen.append(state)
                said = []
                for layer, message in zip(self.weights.layers, self.edges.of(*state), strict=True):
                    receiver, sender = layer.ends(node)
                    said.append(sender.reshape(*shape, -1))
                    message += receiver.reshape(*shape, 1, -1)
                    message += said[-1][:, None]
                    node, _ = layer.forward(node, message.flatten(0, 1), blocked)
                senders.append(torch.stack(said))
                return node, []

            taken, _ = self._roll(z, h, cars_of(batch, None, self.options), steps, hear)
            said = torch.stack(senders)
        # out of inference mode, so that autograd may see what is made of it
        trace = Trace(torch.from_numpy(np.moveaxis(np.array(seen), 1, -1)), torch.from_numpy(said.numpy()))
        return _rollout(taken, shape), trace

    def some(
        self, z: Tensor, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> Rollout:
        """Return the futures of *rows*, with gradients to *z*; as :meth:`FastDecoder.some`."""
        run = _Rows(self, h, batch, rows, steps, trace)
        return Rollout(*_Function.apply(z, run))  # type: ignore[no-untyped-call] # PyTorch's

    def _roll(
        self,
        z: Tensor,
        h: Tensor,
        cars: Vehicles,
        steps: int,
        hear: Callable[[Tensor, Motion], tuple[Tensor, list[Heard]]],
    ) -> tuple[list[_Step], Tensor]:
        """Return the steps and the first memory of G vehicles with latents *z* and embeddings *h* (B, R, …)."""
        w = self.weights
        z, h = z.flatten(0, 1), h.flatten(0, 1)
        memory = torch.addmm(w.start_bias, h, w.start_h.t()).addmm_(z, w.start_z.t()).tanh_()
        given = torch.addmm(w.node_bias, z, w.node_z.t())
        motion, first, taken = cars.start(), memory, []
        for _ in range(steps):
            step = self._step(memory, given, cars, motion, hear)
            taken.append(step)
            memory, motion = torch.lerp(step.new, memory, step.gates[1]), step.driven.motion
        return taken, first

    def _step(
        self,
        memory: Tensor,
        given: Tensor,
        cars: Vehicles,
        motion: Motion,
        hear: Callable[[Tensor, Motion], tuple[Tensor, list[Heard]]],
    ) -> _Step:
        w, width = self.weights, self.weights.width
        held = torch.addmm(w.held_bias, memory, w.held_t)
        node = held[:, :width] + given
        node = node.addmm_(torch.from_numpy(cars.features(motion)), w.motion_t).relu_()
        mixed, heard = hear(node, motion)
        told = torch.addmm(w.told_bias, mixed, w.told_t)
        hidden = told[:, :width].relu()
        driven = drive(cars, torch.addmm(w.act_bias, hidden, w.act_t).numpy(), motion)
        done = blank((len(driven.accel), 2), driven.accel)
        done[:, 0], done[:, 1] = driven.accel, driven.curvature
        done *= self._scale
        gates = told[:, width:].addmm_(torch.from_numpy(done), w.done_t)
        both = (gates[:, : 2 * width] + held[:, width : 3 * width]).sigmoid_()
        reset, update = both[:, :width], both[:, width:]
        last = held[:, 3 * width :]
        new = torch.addcmul(gates[:, 2 * width :], reset, last).tanh_()
        return _Step(memory, node, heard, hidden, (reset, update), new, last, driven)


class _Rows:
    """A roll-out of some rows against a trace, and its gradient."""

    def __init__(
        self, decoder: ArrayDecoder, h: Tensor, batch: SceneBatch, rows: Tensor, steps: int, trace: Trace
    ) -> None:
        self.decoder, self.rows, self.steps, self.trace = decoder, rows, steps, trace
        self.h, self.cars = h[:, rows].detach(), cars_of(batch, rows, decoder.options)
        self.blocked = _blocked(batch, len(rows))
        self.shape = (batch.scenes, len(rows))
        self.taken: list[_Step] = []
        self.first = h

    def forward(self, z: Tensor) -> list[_Step]:
        """Roll out latents (B, R, Z)."""
        trace, layers = self.trace, self.decoder.weights.layers
        x, y, yaw, speed = np.moveaxis(trace.motion[: self.steps].flatten(0, 1).numpy(), -1, 0)
        seen = self.decoder.edges.of(x, y, yaw, speed, self.rows.numpy())
        edges = [part.reshape(self.steps, *self.shape, *part.shape[2:]) for part in seen]

        def hear(node: Tensor, _: Motion) -> tuple[Tensor, list[Heard]]:
            k, kept = len(self.heard), []
            for number, layer in enumerate(layers):
                receiver, sender = layer.ends(node)
                said = trace.senders[k, number].index_copy(1, self.rows, sender.reshape(*self.shape, -1))
                message = edges[number][k] + receiver.reshape(*self.shape, 1, -1)
                message += said[:, None]
                node, heard = layer.forward(node, message.flatten(0, 1), self.blocked)
                kept.append(heard)
            self.heard.append(kept)
            return node, kept

        self.heard: list[list[Heard]] = []
        with torch.inference_mode():
            self.taken, self.first = self.decoder._roll(z, self.h, self.cars, self.steps, hear)
        return self.taken

    def back(self, grads: tuple[Tensor, ...]) -> Tensor:
        """Return the gradient (B, R, Z) for gradients of the five parts of a roll-out."""
        xy, yaw, speed, accel, curvature = (part.flatten(0, 1).numpy() for part in grads)
        w, cars = self.decoder.weights, self.cars
        with torch.inference_mode():
            memory = torch.zeros_like(self.first)
            given = torch.zeros_like(self.first)
            motion = Motion(*(np.zeros_like(cars.x) for _ in range(4)))
            for k in reversed(range(self.steps)):
                here = Motion(xy[:, k, 0], xy[:, k, 1], yaw[:, k], speed[:, k])
                controls = accel[:, k], curvature[:, k]
                memory, node, motion = self._back_step(self.taken[k], memory, motion + here, *controls)
                given += node
            start = memory * (1.0 - self.first.square())
            made = torch.mm(start, w.start_z).addmm_(given, w.node_z)
        return torch.from_numpy(made.numpy()).reshape(*self.shape, -1)

    def _back_step(
        self, step: _Step, memory: Tensor, motion: Motion, accel: Array, curvature: Array
    ) -> tuple[Tensor, Tensor, Motion]:
        """Return the gradients of the memory, the node before its ReLU and the motion before a step."""
        w, (reset, update) = self.decoder.weights, step.gates
        new = memory * (1.0 - update) * (1.0 - step.new.square())
        by_reset = new * step.held * reset * (1.0 - reset)
        by_update = memory * (step.memory - step.new) * update * (1.0 - update)
        done = torch.mm(torch.cat((by_reset, by_update, new), dim=1), w.done).numpy() * self.decoder._scale
        raw, before = drive_back(self.cars, step.driven, motion, accel + done[:, 0], curvature + done[:, 1])
        hidden = torch.mm(torch.from_numpy(raw), w.act) * (step.hidden > 0.0)
        node = torch.mm(torch.cat((hidden, by_reset, by_update, new), dim=1), w.told)
        for layer, heard in zip(reversed(w.layers), reversed(step.heard), strict=True):
            node = self._back_layer(layer, node, heard)
        node = node * (step.node > 0.0)
        before = before + self.cars.features_back(torch.mm(node, w.motion).numpy(), step.driven.before)
        held = torch.cat((node, by_reset, by_update, new * reset), dim=1)
        return torch.mm(held, w.held).addcmul_(memory, update), node, before

    def _back_layer(self, layer: GraphLayer, grad: Tensor, heard: Heard) -> Tensor:
        past, message = layer.back(grad, heard)
        split = message.reshape(*self.shape, *message.shape[1:])  # (B, R, A, M)
        sender = split.sum(1)[:, self.rows].flatten(0, 1)
        return past + layer.back_ends(message.sum(1), sender)


class _Function(torch.autograd.Function):
    """Autograd's view of :class:`_Rows`."""

    @staticmethod
    def forward(ctx: Any, z: Tensor, run: _Rows) -> tuple[Tensor, ...]:
        ctx.run = run
        rollout = _rollout(run.forward(z.detach()), run.shape)
        return rollout.xy, rollout.yaw, rollout.speed, rollout.accel, rollout.curvature

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        return ctx.run.back(grads), None


def cars_of(batch: SceneBatch, rows: Tensor | None, options: ModelOptions) -> Vehicles:
    """Return the vehicles of *batch*, or *rows* of each scene, one after the other."""
    pose, length, moved = batch.pose, batch.size[..., 0], batch.moved.to(batch.past.dtype)
    if rows is not None:
        pose, length, moved = pose[:, rows], length[:, rows], moved[:, rows]
    return Vehicles.of(pose.flatten(0, 1).numpy(), length.flatten().numpy(), moved.flatten().numpy(), options)


def _blocked(batch: SceneBatch, receivers: int) -> Tensor | None:
    """Return (B R, A) what scores of absent senders are lowered by; None where all are there."""
    if bool(batch.present.all()):
        return None
    lower = torch.where(batch.present, 0.0, -1e9).to(batch.past.dtype)
    return lower.repeat_interleave(receivers, dim=0)


def _rollout(taken: list[_Step], shape: tuple[int, ...]) -> Rollout:
    def column(read: Callable[[Driven], Array]) -> Tensor:
        made = np.stack([read(step.driven) for step in taken], axis=1)  # (G, T)
        return torch.from_numpy(made.reshape(*shape, len(taken)))

    xy = torch.stack((column(lambda d: d.motion.x), column(lambda d: d.motion.y)), dim=-1)
    return Rollout(
        xy,
        column(lambda d: d.motion.yaw),
        column(lambda d: d.motion.speed),
        column(lambda d: d.accel),
        column(lambda d: d.curvature),
    )
