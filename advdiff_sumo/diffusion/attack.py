"""The objective of a guided attack, with gradients by autograd; on CPUs its costs run as compiled machine code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.attack_costs import COSTS, seen_attack
from advdiff_sumo.diffusion.bodies import AttackStates, attack_distances
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import Objective
from advdiff_sumo.diffusion.machine_code import MachineCode, machine_code, package_for
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout, Trace
from advdiff_sumo.models.gaussian import Gaussian

OTHERS_WEIGHT, ROAD_WEIGHT, PRIOR_WEIGHT = 10.0, 4.0, 0.01


@dataclass(frozen=True)
class Natural:
    """Natural futures of all agents, without an attack, in one scene; target in row 0.

    Attributes:
        rollout: (1, A, T) futures.
        trace: of that rollout, for rollouts of only some agents.
    """

    rollout: Rollout
    trace: Trace

    @property
    def steps(self) -> int:
        """Number of instants of the rollout."""
        return int(self.rollout.yaw.shape[2])


@dataclass(frozen=True)
class AttackScene:
    """Attackers of one scene, for B samples at once.

    Attributes:
        decoder: from latents to futures.
        codec: from scaled latents to the decoder's.
        context: of the scene.
        batch: the scene.
        rows: (R,) rows of the attackers, without the target (row 0).
        natural: futures without an attack.
    """

    decoder: FastDecoder
    codec: LatentCodec
    context: Context
    batch: SceneBatch
    rows: Tensor
    natural: Natural


class CostsOnTensors(nn.Module):
    """Costs of attackers of all kinds, without the prior's, as a module of tensors, to be compiled."""

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor]:
        """Return costs (B, R) of the attackers' positions (B, R, T, 2), headings and speeds (B, R, T) in *free*.

        *held* are the weights (6,) of the kinds in ``COSTS``, then the parts of an ``AttackStates``.
        """
        (xy, yaw, speed), (kinds, *parts) = free, held
        return (costs(Rollout(xy, yaw, speed, speed, speed), AttackStates.from_tensors(parts), kinds),)


def plain_objective(kind: str, scene: AttackScene, compiled: bool = True) -> Objective:
    """Return the objective to maximise: minus the mean of :func:`attack_losses` over the attackers."""
    losses = attack_losses(kind, scene, compiled)
    return lambda latents: -losses(latents).mean(-1)


def attack_losses(kind: str, scene: AttackScene, compiled: bool = True) -> Callable[[Tensor], Tensor]:
    """Return the loss (B, R) of each attacker: the cost of *kind*, of ``COSTS``, plus costs of implausible motion.

    Those are overlap with vehicles other than the target, leaving the road, and low likelihood under the prior.
    """
    rows, whole = scene.rows, scene.context.prior
    cost_of = _costs_of(kind, AttackStates.of(scene.batch, rows, scene.natural.rollout), compiled)
    prior = Gaussian(whole.mean[:, rows], whole.logvar[:, rows])
    repeated = cache(scene.batch.repeat)

    def value(latents: Tensor) -> Tensor:
        z = scene.codec.unscale(latents[:, rows, None])[:, :, 0]
        return cost_of(_futures(scene, z, repeated)) + PRIOR_WEIGHT * prior_distance(prior, z)

    return value


def costs_package() -> Path:
    """Return the path of the machine code of :class:`CostsOnTensors`, which may not exist."""
    return package_for("attack-costs", sorted(COSTS))


@cache
def _compiled_costs() -> MachineCode | None:
    return machine_code(costs_package(), CostsOnTensors())


def _costs_of(kind: str, placed: AttackStates, compiled: bool) -> Callable[[Rollout], Tensor]:
    kinds = placed.xy.new_tensor([float(name == kind) for name in COSTS])
    is_on_cpu = placed.xy.device.type == "cpu" and placed.xy.dtype == torch.float32
    code = _compiled_costs() if compiled and is_on_cpu else None
    if code is None:
        return lambda rollout: costs(rollout, placed, kind)
    held = [kinds, *placed.tensors()]
    return lambda rollout: code([rollout.xy, rollout.yaw, rollout.speed], held)[0]


def costs(rollout: Rollout, placed: AttackStates, kind: str | Tensor) -> Tensor:
    """Return costs (B, R) of *kind*: a name, or a tensor (6,) with a weight for each kind."""
    met = attack_distances(rollout, placed)
    seen = seen_attack(rollout, met.gap, placed)
    if isinstance(kind, str):
        aim = COSTS[kind](seen)
    else:
        aim = (torch.stack([cost(seen) for cost in COSTS.values()], dim=-1) * kind).sum(-1)
    return aim + OTHERS_WEIGHT * met.overlap + ROAD_WEIGHT * met.off


def _futures(scene: AttackScene, z: Tensor, repeated: Callable[[int], SceneBatch]) -> Rollout:
    """Return futures (B, R, T) of the attackers for latents *z* (B, R, Z), while all others move naturally.

    *repeated* returns the batch repeated that many times, always the same object for the same number.
    """
    count, natural = len(z), scene.natural
    batch = scene.batch if count == 1 else repeated(count)
    h, trace = scene.context.h.expand(count, -1, -1), natural.trace.repeat(count)
    return scene.decoder.some(z, h, batch, scene.rows, natural.steps, trace)


def prior_distance(prior: Gaussian, z: Tensor) -> Tensor:
    """Return half the squared Mahalanobis distance (B, A) of *z* (B, A, Z) from the prior's mean."""
    return 0.5 * ((z - prior.mean).square() * torch.exp(-prior.logvar)).sum(-1)
