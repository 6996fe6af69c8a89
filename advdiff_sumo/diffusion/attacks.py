"""Kinds of attack as differentiable objectives of what the decoder makes of the attackers' latents.

Each compares the attackers' futures with the target's natural one, which is not differentiated: to collide with
where the target is going to be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.diffusion.bodies import Placed, bodies_of, distance
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.guides import Objective
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.geometry import into_frame
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.trace import Trace

SOFT_M = 1.0
TOUCHES_M = -0.5
"""Nearer than this does not count as more."""
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
class Encounter:
    """Attackers' futures as the target on its natural way sees them; each (B, R, T) unless told otherwise.

    Attributes:
        gap: distance of the bodies.
        ahead: position along the target's heading.
        left: position to its left.
        same: cosine of the angle between the headings.
        speed: of the attacker.
        target_speed: of the target, (T,).
        reach: (R, 1) half the sum of both lengths.
        time_s: (T,) instants.
    """

    gap: Tensor
    ahead: Tensor
    left: Tensor
    same: Tensor
    speed: Tensor
    target_speed: Tensor
    reach: Tensor
    time_s: Tensor


def encounter(
    rollout: Rollout, size: Tensor, natural: Natural, target_size: Tensor, gap: Tensor | None = None
) -> Encounter:
    """Return how *rollout* (B, R, T) of vehicles of *size* (R, 2) meets the target of *target_size* (2,).

    Args:
        rollout: of the attackers.
        size: their length and width.
        natural: where the target goes.
        target_size: its length and width.
        gap: (B, R, T) distance of the bodies where it is known.
    """
    target = natural.rollout
    xy, yaw, speed = target.xy[0, 0], target.yaw[0, 0], target.speed[0, 0]
    steps = rollout.yaw.shape[2]
    offset = into_frame(rollout.xy, xy[:steps], yaw[:steps].expand(rollout.yaw.shape))
    if gap is None:
        gap = distance(rollout, size, xy[:steps], yaw[:steps], target_size)
    return Encounter(
        gap=gap,
        ahead=offset[..., 0],
        left=offset[..., 1],
        same=torch.cos(rollout.yaw - yaw[:steps]),
        speed=rollout.speed,
        target_speed=speed[:steps],
        reach=0.5 * (size[:, :1] + target_size[0]),
        time_s=MODEL_STEP_S * torch.arange(1, steps + 1, device=xy.device),
    )


def nearest(gap: Tensor) -> Tensor:
    """Return the smooth least (B, R) of gaps (B, R, T)."""
    return -SOFT_M * torch.logsumexp(-gap.clamp(min=TOUCHES_M) / SOFT_M, dim=-1)


def _between(value: Tensor, low: Tensor | float, high: Tensor | float) -> Tensor:
    """Return how far *value* is outside [low, high]."""
    return torch.relu(low - value) + torch.relu(value - high)


def _during(e: Encounter, cost: Tensor, begin_s: float, end_s: float) -> Tensor:
    """Return the mean (B, R) of *cost* (B, R, T) over a span."""
    within = ((e.time_s >= begin_s) & (e.time_s <= end_s)).to(cost.dtype)
    return (cost * within).sum(-1) / within.sum().clamp(min=1.0)


def _any(e: Encounter) -> Tensor:
    return nearest(e.gap)


def _cut_in(e: Encounter) -> Tensor:
    """Into the target's lane ahead of it and slower, between 2 and 4 s."""
    place = e.left.abs() + 0.3 * _between(e.ahead, e.reach + 0.5, e.reach + 6.0)
    slower = 0.3 * torch.relu(e.speed - (e.target_speed - 2.0))
    return _during(e, place + slower + 3.0 * (1.0 - e.same), 1.5, 4.0) + 0.3 * nearest(e.gap)


def _brake(e: Encounter) -> Tensor:
    """Ahead in the target's lane, down to a fifth of its speed."""
    place = e.left.abs() + 0.3 * torch.relu(e.reach - e.ahead)
    slower = 0.5 * torch.relu(e.speed - 0.2 * e.target_speed)
    return _during(e, place + slower, 0.5, 4.0) + 0.3 * nearest(e.gap)


def _rear_end(e: Encounter) -> Tensor:
    """Behind in the target's lane and faster by 3 m/s."""
    place = e.left.abs() + 0.2 * _between(e.ahead, -e.reach - 1.0, -e.reach + 0.5)
    faster = 0.3 * torch.relu(e.target_speed + 3.0 - e.speed)
    return _during(e, place + faster, 1.0, 4.0) + 0.5 * nearest(e.gap)


def _head_on(e: Encounter) -> Tensor:
    """Into the target's lane against its heading."""
    meeting = torch.exp(-(e.gap.detach().clamp(min=0.0) / 15.0))
    return nearest(e.gap) + (meeting * (0.5 * e.left.abs() + (1.0 + e.same))).mean(-1)


def _junction(e: Encounter) -> Tensor:
    """Across the target's way at the same place and time."""
    meeting = torch.exp(-(e.gap.detach().clamp(min=0.0) / 5.0))
    return nearest(e.gap) + (meeting * e.same.square()).mean(-1)


COSTS: Mapping[str, Callable[[Encounter], Tensor]] = {
    "any": _any,
    "cut-in": _cut_in,
    "rear-end": _rear_end,
    "head-on": _head_on,
    "junction": _junction,
    "brake": _brake,
}
"""What an attack of each kind makes small, (B, R)."""


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


def attack_objective(kind: str, scene: AttackScene) -> Objective:
    """Return what the attackers shall make large: minus the cost of *kind*, of ``COSTS``, and of being implausible.

    Implausible is to overlap another vehicle but the target, to leave the road, and what the prior finds unlikely.
    """
    if scene.decoder.compiled is None:
        return tensor_attack(kind, scene)
    from advdiff_sumo.diffusion.compiled.attack import CompiledAttack

    return CompiledAttack(kind, scene, scene.decoder.compiled)


def tensor_attack(kind: str, scene: AttackScene) -> Objective:
    """Return :func:`attack_objective` on tensors, with gradients by autograd."""
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
        loss = aim + OTHERS_WEIGHT * met.overlap + ROAD_WEIGHT * met.off + unlikely
        return -loss.mean(-1)

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
