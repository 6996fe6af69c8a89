"""The slope of an attack as machine code: the attackers' rollout, its costs and its prior in one, backwards.

It is made of the networks' own methods for the paper's decoder, where attackers see all others at the places of the
trace: how they lie to each other is then the same for all latents, and worked out once a plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.attack import PRIOR_WEIGHT, AttackScene, costs, plain_objective, surprise
from advdiff_sumo.diffusion.attack_costs import COSTS
from advdiff_sumo.diffusion.bodies import Placed
from advdiff_sumo.diffusion.exported_step import scene_of_tensors, step_sizes
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import autograd_slope
from advdiff_sumo.diffusion.machine_code import MachineCode, machine_code, package_for
from advdiff_sumo.models.decoder import Decoder, Rollout, Surroundings, motion_now, rollout_of
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.model_options import ModelOptions


class AttackOnTensors(nn.Module):
    """What attackers shall make small, of latents, with tensors for arguments.

    Args:
        decoder: the paper's.
        steps: of the rollout.
    """

    def __init__(self, decoder: Decoder, steps: int) -> None:
        super().__init__()
        self.decoder, self._steps = decoder, steps

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor]:
        """Return (B, R) costs.

        Args:
            free: (B, R, Z) scaled latents of the attackers.
            held: of :func:`tensors_of`.
        """
        kinds, scale, offset, mean, logvar, h, *around = held
        rows, present, own_present, edges, senders, *parts = around
        placed, z = Placed.from_tensors(tuple(parts)), free[0] * scale + offset
        own = scene_of_tensors(
            *(
                part.expand(z.shape[0], *part.shape)
                for part in (placed.own_pose, placed.own_size, own_present, placed.moved)
            )
        )
        batch = scene_of_tensors(own.pose, own.size, present[None], own.moved)
        rollout = self._roll(z, h, Surroundings(batch, own, rows), edges, senders)
        return (costs(rollout, placed, kinds) + PRIOR_WEIGHT * surprise(Gaussian(mean, logvar), z),)

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


class SlopedAttack:
    """What the attackers of a scene shall make large, as ``attack``, with its slope by machine code.

    Args:
        kind: a key of ``COSTS``.
        scene: who attacks, and where.
        code: of :func:`attack_code`, for the steps of the scene.
    """

    def __init__(self, kind: str, scene: AttackScene, code: MachineCode) -> None:
        self._kind, self._scene, self._code = kind, scene, code
        self._held = tensors_of(kind, scene)

    def __call__(self, latents: Tensor) -> Tensor:
        """Return the objective (B,) of scaled *latents* (B, A, Z), with gradients to them."""
        return plain_objective(self._kind, self._scene)(latents)

    @torch.no_grad()
    def slope(self, latents: Tensor) -> Tensor:
        """Return the slope (B, A, Z) of the objective at scaled *latents* (B, A, Z)."""
        rows = self._scene.rows
        share = latents.new_full((len(latents), len(rows)), -1.0 / len(rows))
        given = [latents[:, rows], *self._held, share]
        if not self._code.fits(given):
            return autograd_slope(self, latents)
        out = torch.zeros_like(latents)
        out[:, rows] = self._code.value(given)[0]
        return out


def attack_package(options: ModelOptions, steps: int) -> Path:
    """Return where the machine code of an attack's slope ships, if it does."""
    return package_for("attack-slope", {**step_sizes(options), "steps": steps, "kinds": sorted(COSTS)})


@lru_cache(maxsize=4)
def attack_code(decoder: FastDecoder, steps: int) -> MachineCode | None:
    """Return the machine code of the slopes of attacks of so many *steps*, or None where there is none."""
    net = decoder.network
    if not decoder.compiled or decoder.closed_loop:
        return None
    return machine_code(attack_package(net.options, steps), AttackOnTensors(net, steps))


@torch.no_grad()
def tensors_of(kind: str, scene: AttackScene) -> list[Tensor]:
    """Return what :class:`AttackOnTensors` holds."""
    rows, trace, context = scene.rows, scene.natural.trace, scene.context
    kinds = context.h.new_tensor([float(name == kind) for name in COSTS])
    prior = context.prior.mean[0, rows], context.prior.logvar[0, rows]
    codec = scene.codec.std[0], scene.codec.mean[0]
    motion = trace.motion[:, 0]
    edges = torch.stack(
        scene.decoder.network.edges((motion[..., :2], motion[..., 2], motion[..., 3]), rows), dim=1
    )
    seen = rows, scene.batch.present[0], scene.batch.present[0, rows], edges, trace.senders[:, :, 0]
    placed = Placed.of(scene.batch, rows, scene.natural.rollout)
    return [kinds, *codec, *prior, context.h[0, rows], *seen, *placed.tensors()]
