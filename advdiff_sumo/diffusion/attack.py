"""The objective of an attack, with gradients by autograd; on a CPU its costs are machine code made of themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from torch import Tensor, nn

from advdiff_sumo.diffusion.attack_costs import COSTS, encounter
from advdiff_sumo.diffusion.bodies import Placed, met_by
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
    """Where everybody would go without an attack, one scene; target in row 0.

    Attributes:
        rollout: futures of all agents, (1, A, T).
        trace: for rollouts of some of them.
    """

    rollout: Rollout
    trace: Trace

    @property
    def steps(self) -> int:
        """Instants of the rollout."""
        return int(self.rollout.yaw.shape[2])


@dataclass(frozen=True)
class AttackScene:
    """Attackers of one scene, drawn B times at once.

    Attributes:
        decoder: makes futures of latents.
        codec: between scaled latents and the decoder's.
        context: of the one scene.
        batch: the one scene.
        rows: (R,) attackers, the target (row 0) not among them.
        natural: where everybody would go without an attack.
    """

    decoder: FastDecoder
    codec: LatentCodec
    context: Context
    batch: SceneBatch
    rows: Tensor
    natural: Natural


class CostsOnTensors(nn.Module):
    """What attackers shall make small for but the prior, with tensors for arguments, of all kinds."""

    def forward(self, free: Sequence[Tensor], held: Sequence[Tensor]) -> tuple[Tensor]:
        """Return (B, R) costs of places (B, R, T, 2), headings and speeds (B, R, T) of the attackers, *free*.

        *held* is (6,) how much each kind of ``COSTS`` counts, then the parts of a ``Placed``.
        """
        (xy, yaw, speed), (kinds, *parts) = free, held
        return (costs(Rollout(xy, yaw, speed, speed, speed), Placed.from_tensors(parts), kinds),)


def plain_objective(kind: str, scene: AttackScene, compiled: bool = True) -> Objective:
    """Return what the attackers shall make large: minus the mean of :func:`attack_losses`."""
    losses = attack_losses(kind, scene, compiled)
    return lambda latents: -losses(latents).mean(-1)


def attack_losses(kind: str, scene: AttackScene, compiled: bool = True) -> Callable[[Tensor], Tensor]:
    """Return what each attacker shall make small (B, R): the cost of *kind*, of ``COSTS``, and of being implausible.

    Implausible is to overlap another vehicle but the target, to leave the road, and what the prior finds unlikely.
    """
    rows, whole = scene.rows, scene.context.prior
    cost_of = _costs_of(kind, Placed.of(scene.batch, rows, scene.natural.rollout), compiled)
    prior = Gaussian(whole.mean[:, rows], whole.logvar[:, rows])
    repeated = cache(scene.batch.repeat)

    def value(latents: Tensor) -> Tensor:
        z = scene.codec.unscale(latents[:, rows, None])[:, :, 0]
        return cost_of(_futures(scene, z, repeated)) + PRIOR_WEIGHT * surprise(prior, z)

    return value


def costs_package() -> Path:
    """Return where the machine code of :class:`CostsOnTensors` ships, if it does."""
    return package_for("attack-costs", sorted(COSTS))


@cache
def _compiled_costs() -> MachineCode | None:
    return machine_code(costs_package(), CostsOnTensors())


def _costs_of(kind: str, placed: Placed, compiled: bool) -> Callable[[Rollout], Tensor]:
    kinds = placed.xy.new_tensor([float(name == kind) for name in COSTS])
    here = placed.xy.device.type == "cpu" and placed.xy.dtype == torch.float32
    code = _compiled_costs() if compiled and here else None
    if code is None:
        return lambda rollout: costs(rollout, placed, kind)
    held = [kinds, *placed.tensors()]
    return lambda rollout: code([rollout.xy, rollout.yaw, rollout.speed], held)[0]


def costs(rollout: Rollout, placed: Placed, kind: str | Tensor) -> Tensor:
    """Return costs (B, R) of *kind*, or of all kinds together, each counted as a tensor says."""
    met = met_by(rollout, placed)
    seen = encounter(rollout, met.gap, placed)
    if isinstance(kind, str):
        aim = COSTS[kind](seen)
    else:
        aim = (torch.stack([cost(seen) for cost in COSTS.values()], dim=-1) * kind).sum(-1)
    return aim + OTHERS_WEIGHT * met.overlap + ROAD_WEIGHT * met.off


def _futures(scene: AttackScene, z: Tensor, repeated: Callable[[int], SceneBatch]) -> Rollout:
    """Return the futures (B, R, T) of the attackers' latents *z* (B, R, Z) against everybody's natural ones.

    *repeated* gives the batch so many times, the same object for the same number.
    """
    count, natural = len(z), scene.natural
    batch = scene.batch if count == 1 else repeated(count)
    h, trace = scene.context.h.expand(count, -1, -1), natural.trace.repeat(count)
    return scene.decoder.some(z, h, batch, scene.rows, natural.steps, trace)


def surprise(prior: Gaussian, z: Tensor) -> Tensor:
    """Return half the squared distance (B, A) of *z* (B, A, Z) from the prior's mean in its deviations."""
    return 0.5 * ((z - prior.mean).square() * torch.exp(-prior.logvar)).sum(-1)
