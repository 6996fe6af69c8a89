"""The roll-out of everybody, as ``models.decoder``, for tensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Decoder, Forced, Rollout
from advdiff_sumo.models.model_options import FUTURE_STEPS
from advdiff_sumo.traffic.baselines.joint.cell import Cell, Kept
from advdiff_sumo.traffic.baselines.joint.edges import Edges, Looks
from advdiff_sumo.traffic.baselines.joint.ego_features import own_motion, own_motion_back
from advdiff_sumo.traffic.baselines.joint.joint_arrays import Array, Linear, array_of, relu
from advdiff_sumo.traffic.baselines.joint.joint_graph import Activations, Layer
from advdiff_sumo.traffic.baselines.joint.joint_vehicle import Cars, Driven, drive, drive_back

_CONTROL_SCALE = (0.25, 10.0)
"""Acceleration and curvature as the memory is told of them."""


@dataclass(frozen=True)
class Given:
    """One scene.

    Attributes:
        h: (A, D) embeddings.
        cars: its agents.
        states: (A, T, 4) where the future is given.
        known: (A, T) for whom it is.
    """

    h: Array
    cars: Cars
    states: Array
    known: Array


@dataclass(frozen=True)
class _Step:
    """What one step leaves for its gradient."""

    motion: Array
    node: Array
    looks: Looks
    activations: list[Activations]
    hidden: Array
    driven: Driven
    kept: Kept


class JointDecoder:
    """Rolls out one scene with everybody in it present, and differentiates by all latents.

    Args:
        decoder: the trained network, whose weights are read when this is made.
    """

    def __init__(self, decoder: Decoder) -> None:
        wide, latent = decoder.options.hidden, decoder.options.latent
        self.options = decoder.options
        start, node = Linear.of(decoder.start), Linear.of(decoder.node)
        self._start_bias, self._node_bias = start.bias, node.bias
        self._start_h, self._start_z = start.columns(0, wide), start.columns(wide, wide + latent)
        self._node_memory, self._node_z = node.columns(0, wide), node.columns(wide, wide + latent)
        self._node_own = node.columns(wide + latent, node.back.shape[1])
        self._edges = Edges(decoder.interaction)
        self._layers = [Layer(x) for x in decoder.interaction.in_order()]
        self._hidden, self._act = Linear.of(decoder.action[0]), Linear.of(decoder.action[2])
        self._cell = Cell(decoder.memory)

    def __call__(
        self,
        z: Tensor,
        h: Tensor,
        batch: SceneBatch,
        steps: int = FUTURE_STEPS,
        forced: Forced | None = None,
    ) -> Rollout:
        """Return the futures (1, A, T) of latents *z* (1, A, Z), with gradients to them; see ``Decoder.forward``."""
        outputs: tuple[Tensor, ...] = _Function.apply(z, self, self._given(h, batch, steps, forced))  # type: ignore[no-untyped-call] # PyTorch's
        return Rollout(*outputs)

    def _given(self, h: Tensor, batch: SceneBatch, steps: int, forced: Forced | None) -> Given:
        pose, agents = array_of(batch.pose[0]), batch.agents
        cars = Cars.of(pose, array_of(batch.size[0, :, 0]), array_of(batch.moved[0]), self.options)
        states = np.zeros((agents, steps, 4), pose.dtype)
        known = np.zeros((agents, steps), dtype=np.bool_)
        if forced is not None:
            states, known = array_of(forced.states[0, :, :steps]), array_of(forced.mask[0, :, :steps])
        return Given(array_of(h[0]), cars, states, known)

    def roll(self, z: Array, given: Given) -> tuple[Array, Array, list[_Step]]:
        """Return the futures (A, T, 6) of *z* (A, Z): x, y, yaw, speed, acceleration, curvature; and its steps."""
        memory = first = np.tanh(self._start_h(given.h) + self._start_z(z) + self._start_bias)
        latent = self._node_z(z) + self._node_bias
        motion = given.cars.begin.copy()
        motion[:, 3] = np.maximum(motion[:, 3], 0.0)
        trajectory, steps = np.empty((*given.known.shape, 6), z.dtype), []
        for k in range(given.known.shape[1]):
            before, own = motion, own_motion(given.cars.begin, motion)
            node = mixed = relu(memory @ self._node_memory.forth + latent + own @ self._node_own.forth)
            looks, activations = self._edges.look(motion), []
            for layer in self._layers:
                mixed, one = layer.forward(mixed, looks.embedded)
                activations.append(one)
            hidden = relu(self._hidden(mixed))
            motion, driven = drive(given.cars, self._act(hidden), motion)
            motion = np.where(given.known[:, k, None], given.states[:, k], motion)
            done = np.stack((driven.accel, driven.curvature), axis=-1)
            trajectory[:, k, :4], trajectory[:, k, 4:] = motion, done
            cell_inputs = np.concatenate((mixed, np.multiply(done, _CONTROL_SCALE, dtype=done.dtype)), axis=1)
            memory, kept = self._cell.keep(cell_inputs, memory)
            steps.append(_Step(before, node, looks, activations, hidden, driven, kept))
        return trajectory, first, steps

    def roll_back(self, given: Given, first: Array, steps: list[_Step], grad: Array) -> Array:
        """Return the gradient (A, Z) of the latents for *grad* (A, T, 6) of what :meth:`roll` made."""
        memory, latent = np.zeros_like(first), np.zeros_like(first)
        motion = np.zeros((len(first), 4), first.dtype)
        for k in range(len(steps) - 1, -1, -1):
            step = steps[k]
            cell_gradient, memory = self._cell.keep_back(step.kept, memory)
            mixed, done = cell_gradient[:, :-2], cell_gradient[:, -2:] * np.array(_CONTROL_SCALE, first.dtype)
            motion = np.where(given.known[:, k, None], 0.0, motion + grad[:, k, :4])
            raw, motion = drive_back(given.cars, step.driven, motion, done + grad[:, k, 4:])
            mixed = mixed + ((raw @ self._act.back) * (step.hidden > 0.0)) @ self._hidden.back
            looks = np.zeros_like(step.looks.embedded)
            for layer, activations in zip(reversed(self._layers), reversed(step.activations), strict=True):
                mixed, edge_gradient = layer.back(activations, mixed)
                looks = looks + edge_gradient
            node = mixed * (step.node > 0.0)
            own = own_motion_back(given.cars.begin, step.motion, node @ self._node_own.back)
            motion = motion + self._edges.look_back(step.looks, looks) + own
            memory, latent = memory + node @ self._node_memory.back, latent + node
        memory = memory * (1.0 - first * first)
        latent_gradient: Array = memory @ self._start_z.back + latent @ self._node_z.back
        return latent_gradient


class _Function(torch.autograd.Function):
    """Autograd's view of a roll-out."""

    @staticmethod
    def forward(ctx: Any, z: Tensor, decoder: JointDecoder, given: Given) -> tuple[Tensor, ...]:
        trajectory, first, steps = decoder.roll(array_of(z[0]), given)
        ctx.back = lambda grad: decoder.roll_back(given, first, steps, grad)
        whole = torch.from_numpy(trajectory)[None]
        return whole[..., :2], whole[..., 2], whole[..., 3], whole[..., 4], whole[..., 5]

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        every = torch.cat((grads[0], torch.stack(grads[1:], dim=-1)), dim=-1)
        return torch.from_numpy(ctx.back(array_of(every[0])))[None], None, None
