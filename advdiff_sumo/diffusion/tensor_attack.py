"""The objective of an attack on tensors of any device, with gradients by autograd."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.diffusion.attack_costs import COSTS, Natural, encounter
from advdiff_sumo.diffusion.fast_bodies import bodies_of
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import Objective
from advdiff_sumo.diffusion.tensor_bodies import Placed
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.gaussian import Gaussian

OTHERS_WEIGHT, ROAD_WEIGHT, PRIOR_WEIGHT = 10.0, 4.0, 0.01


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


def tensor_attack(kind: str, scene: AttackScene) -> Objective:
    """Return what the attackers shall make large: minus the mean of :func:`attack_losses`."""
    losses = attack_losses(kind, scene)
    return lambda latents: -losses(latents).mean(-1)


def attack_losses(kind: str, scene: AttackScene) -> Callable[[Tensor], Tensor]:
    """Return what each attacker shall make small (B, R): the cost of *kind*, of ``COSTS``, and of being implausible.

    Implausible is to overlap another vehicle but the target, to leave the road, and what the prior finds unlikely.
    """
    rows, size, natural = scene.rows, scene.batch.size[0], scene.natural
    bodies = bodies_of(Placed(scene.batch, rows, natural.rollout))
    cost = COSTS[kind]
    whole = scene.context.prior
    prior = Gaussian(whole.mean[:, rows], whole.logvar[:, rows])

    def value(latents: Tensor) -> Tensor:
        z = scene.codec.unscale(latents[:, rows, None])[:, :, 0]
        rollout = _futures(scene, z)
        met = bodies(rollout)
        unlikely = PRIOR_WEIGHT * surprise(prior, z)
        aim = cost(encounter(rollout, size[rows], natural, size[0], met.gap))
        return aim + OTHERS_WEIGHT * met.overlap + ROAD_WEIGHT * met.off + unlikely

    return value


def _futures(scene: AttackScene, z: Tensor) -> Rollout:
    """Return the futures (B, R, T) of the attackers' latents *z* (B, R, Z) against everybody's natural ones."""
    count, trace = len(z), scene.natural.trace
    if count == 1:
        h, batch = scene.context.h, scene.batch
    else:
        h, batch, trace = (
            scene.context.h.expand(count, -1, -1),
            scene.batch.repeat(count),
            trace.repeat(count),
        )
    return scene.decoder.some(z, h, batch, scene.rows, scene.natural.steps, trace)


def surprise(prior: Gaussian, z: Tensor) -> Tensor:
    """Return half the squared distance (B, A) of *z* (B, A, Z) from the prior's mean in its deviations."""
    return 0.5 * ((z - prior.mean).square() * torch.exp(-prior.logvar)).sum(-1)
