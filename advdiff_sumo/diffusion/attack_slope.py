"""The gradient of an attack's objective: by machine code, or by central differences for the closed-loop decoder.

The machine code is the gradient of the attackers' rollout, costs and prior in one function, compiled from the networks'
own methods. It serves the paper's decoder, where attackers observe all agents at their states in the trace: relative
poses are then the same for all latents, and are computed once a plan.

A gradient through a closed-loop decoder takes 40 ms. There, only the latents with the largest standard deviations are
varied: in the shipped decoder, four of 32 carry 95 % of the squared gradient. All variations, of all attackers at once,
are evaluated in one rollout without gradients; each attacker's differences are those of its own loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.attack import (
    PRIOR_WEIGHT,
    AttackScene,
    attack_losses,
    costs,
    plain_objective,
    prior_distance,
)
from advdiff_sumo.diffusion.attack_costs import COSTS
from advdiff_sumo.diffusion.bodies import AttackStates
from advdiff_sumo.diffusion.exported_step import scene_of_tensors, step_sizes
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import Objective, Sloped, autograd_slope
from advdiff_sumo.diffusion.machine_code import MachineCode, machine_code, package_for
from advdiff_sumo.models.decoder import Decoder, Rollout, Surroundings, motion_now, rollout_of
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.model_options import ModelOptions

WIDEST = 4
"""Number of latents along which differences are taken."""
STEP = 0.25
"""Step of the central differences, in standard deviations of the latents."""


class AttackOnTensors(nn.Module):
    """Attackers' losses over *steps* of the paper's *decoder*, as a module of tensors, to be compiled."""

    def __init__(self, decoder: Decoder, steps: int) -> None:
        super().__init__()
        self.decoder, self._steps = decoder, steps

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor]:
        """Return losses (B, R) of the attackers' scaled latents (B, R, Z) in *free*; *held* are :func:`tensors_of`."""
        kinds, scale, offset, mean, logvar, h, *around = held
        rows, present, own_present, edges, senders, *parts = around
        placed, z = AttackStates.from_tensors(parts), free[0] * scale + offset
        inputs = placed.own_pose, placed.own_size, own_present, placed.moved
        own = scene_of_tensors(*(part.expand(z.shape[0], *part.shape) for part in inputs))
        batch = scene_of_tensors(own.pose, own.size, present[None], own.moved)
        rollout = self._roll(z, h, Surroundings(batch, own, rows), edges, senders)
        return (costs(rollout, placed, kinds) + PRIOR_WEIGHT * prior_distance(Gaussian(mean, logvar), z),)

    def _roll(self, z: Tensor, h: Tensor, around: Surroundings, edges: Tensor, senders: Tensor) -> Rollout:
        memory, motion = self.decoder.begin(z, h.expand(z.shape[0], *h.shape)), motion_now(around.own)
        states = []
        for k in range(self._steps):
            others = senders[k][:, None].expand(-1, z.shape[0], -1, -1)
            seen = [edge[None] for edge in edges[k].unbind(0)]
            state, memory, _ = self.decoder.advance(memory, z, around, motion, seen, others)
            states.append(state)
            motion = state[:3]
        return rollout_of(states)


def attack_objective(kind: str, scene: AttackScene) -> Objective:
    """Return the objective that the attackers of *scene* maximise for *kind*, of ``COSTS``."""
    if scene.decoder.closed_loop:
        return differenced_attack(kind, scene)
    code = attack_code(scene.decoder, scene.natural.steps)
    return plain_objective(kind, scene) if code is None else sloped_attack(kind, scene, code)


def sloped_attack(kind: str, scene: AttackScene, code: MachineCode) -> Sloped:
    """Return the objective with its gradient by *code*, of :func:`attack_code` for the scene's number of steps."""
    rows, kept = scene.rows, tensors_of(kind, scene)

    def value(latents: Tensor) -> Tensor:
        return plain_objective(kind, scene)(latents)

    @torch.no_grad()
    def slope(latents: Tensor) -> Tensor:
        share = latents.new_full((len(latents), len(rows)), -1.0 / len(rows))
        inputs = [latents[:, rows], *kept, share]
        if not code.fitting.holds(inputs):
            return autograd_slope(value, latents)
        out = torch.zeros_like(latents)
        out[:, rows] = code.value(inputs)[0]
        return out

    return Sloped(value, slope)


def differenced_attack(kind: str, scene: AttackScene) -> Sloped:
    """Return the objective with its gradient by central differences along the ``WIDEST`` latents; 0 along others."""
    losses, rows = attack_losses(kind, scene), scene.rows
    deviations = scene.codec.std.flatten()
    widest = deviations.topk(min(WIDEST, len(deviations))).indices

    @torch.no_grad()
    def slope(latents: Tensor) -> Tensor:
        along = STEP * torch.eye(latents.shape[-1], device=latents.device)[widest]
        moves = torch.cat((along, -along))  # (2 K, Z)
        tried = latents[:, None].repeat(1, len(moves), 1, 1)
        tried[:, :, rows] += moves[:, None]
        each = losses(tried.flatten(0, 1)).reshape(len(latents), len(moves), -1)
        ahead, behind = each.chunk(2, dim=1)  # (B, K, R)
        out = torch.zeros_like(latents)
        out[:, rows[:, None], widest] = ((behind - ahead) / (2.0 * STEP * len(rows))).transpose(1, 2)
        return out

    return Sloped(lambda latents: -losses(latents).mean(-1), slope)


def attack_package(options: ModelOptions, steps: int) -> Path:
    """Return the path of the machine code of an attack's gradient, which may not exist."""
    return package_for("attack-slope", {**step_sizes(options), "steps": steps, "kinds": sorted(COSTS)})


@lru_cache(maxsize=4)
def attack_code(decoder: FastDecoder, steps: int) -> MachineCode | None:
    """Return the machine code of attacks over *steps* instants; None if there is none."""
    net = decoder.network
    if not decoder.compiled or decoder.closed_loop:
        return None
    return machine_code(attack_package(net.options, steps), AttackOnTensors(net, steps))


@torch.no_grad()
def tensors_of(kind: str, scene: AttackScene) -> list[Tensor]:
    """Return the argument *held* of :class:`AttackOnTensors`."""
    rows, trace, context = scene.rows, scene.natural.trace, scene.context
    kinds = context.h.new_tensor([float(name == kind) for name in COSTS])
    prior = context.prior.mean[0, rows], context.prior.logvar[0, rows]
    codec = scene.codec.std[0], scene.codec.mean[0]
    xy, (yaw, speed) = trace.motion[:, 0, :, :2], trace.motion[:, 0, :, 2:].unbind(-1)
    edges = torch.stack(scene.decoder.network.edges((xy, yaw, speed), rows), dim=1)
    seen = rows, scene.batch.present[0], scene.batch.present[0, rows], edges, trace.senders[:, :, 0]
    placed = AttackStates.of(scene.batch, rows, scene.natural.rollout)
    return [kinds, *codec, *prior, context.h[0, rows], *seen, *placed.tensors()]
