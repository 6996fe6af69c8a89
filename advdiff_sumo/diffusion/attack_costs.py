"""Kinds of attack as differentiable costs of the attackers' futures.

Each compares the attackers' futures with the target's natural future, which is a constant: the attack aims at the
places where the target is going to be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.diffusion.bodies import AttackStates
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import into_frame
from advdiff_sumo.models.model_options import MODEL_STEP_S

SOFT_M = 1.0
TOUCHES_M = -0.5
"""Smaller gaps have the same cost as this one."""


@dataclass(frozen=True)
class SeenAttack:
    """Attackers' futures in the frame of the target on its natural path; (B, R, T) unless stated otherwise.

    Attributes:
        gap: distance between the vehicles' discs.
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


def seen_attack(rollout: Rollout, gap: Tensor, placed: AttackStates) -> SeenAttack:
    """Return *rollout* (B, R, T) of attackers, at *gap* (B, R, T), in the frame of the target of *placed*."""
    xy, yaw, speed = placed.xy[0], placed.yaw[0], placed.speed[0]
    offset = into_frame(rollout.xy, xy, yaw.expand(rollout.yaw.shape))
    return SeenAttack(
        gap=gap,
        ahead=offset[..., 0],
        left=offset[..., 1],
        same=torch.cos(rollout.yaw - yaw),
        speed=rollout.speed,
        target_speed=speed,
        reach=0.5 * (placed.own_size[:, :1] + placed.size[0, 0]),
        time_s=MODEL_STEP_S * torch.arange(1, yaw.shape[0] + 1, device=xy.device),
    )


def smooth_minimum(gap: Tensor) -> Tensor:
    """Return the smooth minimum (B, R) of gaps (B, R, T)."""
    return -SOFT_M * torch.logsumexp(-gap.clamp(min=TOUCHES_M) / SOFT_M, dim=-1)


def _between(value: Tensor, low: Tensor | float, high: Tensor | float) -> Tensor:
    """Return the distance of *value* from [low, high]."""
    return torch.relu(low - value) + torch.relu(value - high)


def _during(e: SeenAttack, cost: Tensor, begin_s: float, end_s: float) -> Tensor:
    """Return the mean (B, R) of *cost* (B, R, T) from *begin_s* to *end_s*."""
    within = ((e.time_s >= begin_s) & (e.time_s <= end_s)).to(cost.dtype)
    return (cost * within).sum(-1) / within.sum().clamp(min=1.0)


def _meeting(e: SeenAttack, within_m: float) -> Tensor:
    """Return weights (B, R, T) of the instants, larger for smaller gaps; not differentiated."""
    return torch.exp(-(e.gap.detach().clamp(min=0.0) / within_m))


def _any(e: SeenAttack) -> Tensor:
    return smooth_minimum(e.gap)


def _cut_in(e: SeenAttack) -> Tensor:
    """Into the target's lane ahead of it and slower, between 2 and 4 s."""
    place = e.left.abs() + 0.3 * _between(e.ahead, e.reach + 0.5, e.reach + 6.0)
    slower = 0.3 * torch.relu(e.speed - (e.target_speed - 2.0))
    return _during(e, place + slower + 3.0 * (1.0 - e.same), 1.5, 4.0) + 0.3 * smooth_minimum(e.gap)


def _brake(e: SeenAttack) -> Tensor:
    """Ahead in the target's lane, down to a fifth of its speed."""
    place = e.left.abs() + 0.3 * torch.relu(e.reach - e.ahead)
    slower = 0.5 * torch.relu(e.speed - 0.2 * e.target_speed)
    return _during(e, place + slower, 0.5, 4.0) + 0.3 * smooth_minimum(e.gap)


def _rear_end(e: SeenAttack) -> Tensor:
    """Behind in the target's lane and faster by 3 m/s."""
    place = e.left.abs() + 0.2 * _between(e.ahead, -e.reach - 1.0, -e.reach + 0.5)
    faster = 0.3 * torch.relu(e.target_speed + 3.0 - e.speed)
    return _during(e, place + faster, 1.0, 4.0) + 0.5 * smooth_minimum(e.gap)


def _head_on(e: SeenAttack) -> Tensor:
    """Into the target's lane against its heading."""
    meeting = _meeting(e, 15.0)
    return smooth_minimum(e.gap) + (meeting * (0.5 * e.left.abs() + (1.0 + e.same))).mean(-1)


def _junction(e: SeenAttack) -> Tensor:
    """Across the target's path at the same place and time."""
    meeting = _meeting(e, 5.0)
    return smooth_minimum(e.gap) + (meeting * e.same.square()).mean(-1)


COSTS: Mapping[str, Callable[[SeenAttack], Tensor]] = {
    "any": _any,
    "cut-in": _cut_in,
    "rear-end": _rear_end,
    "head-on": _head_on,
    "junction": _junction,
    "brake": _brake,
}
"""Cost (B, R) of each kind of attack."""
