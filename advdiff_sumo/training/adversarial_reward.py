"""Rewards of Q: R = R_adv − P_coll over stretches of executed steps (Sec. III-C)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import wrap_angle
from advdiff_sumo.models.losses import discs, off_road, pair_overlap
from advdiff_sumo.training.presets import RewardOptions

_BETWEEN = 4
"""Instants a model step at which collisions are tested; at 0.5 s, fast cars could pass through each other."""


@dataclass(frozen=True)
class Payoff:
    """Reward of one stretch of an executed plan.

    Attributes:
        reward: (B,) R_adv − P_coll; R_adv is 1 on contact.
        contact: (B,) whether a background vehicle collided with the target.
    """

    reward: Tensor
    contact: Tensor


def payoffs(
    path: Rollout, batch: SceneBatch, target: Tensor, options: RewardOptions, stretches: int
) -> list[Payoff]:
    """Return the payoffs of the first *stretches*, each of ``options.execute`` steps.

    Args:
        path: executed or planned states (B, A, T), T at least stretches × execute; the target's are executed ones.
        batch: the scenes at the beginning.
        target: (B,) row of the target.
        options: reach and weights.
        stretches: their number.
    """
    steps = options.execute * stretches
    cut = first_steps(path, steps)
    shape = (batch.scenes, stretches, -1)
    gap = target_gap(finer(cut, batch), batch, target).amin(1).reshape(shape).amin(-1)  # (B, S)
    near = torch.exp(-gap.clamp(min=0.0) / options.reach_m)
    vehicles = among_background(cut, batch, target).reshape(shape).amax(-1)
    road = over_edge(cut, batch, target).reshape(shape).amax(-1)
    reward = near - options.vehicles * vehicles.clamp(max=1.0) - options.road * road.clamp(max=1.0)
    return [Payoff(reward[:, i], gap[:, i] <= 0.0) for i in range(stretches)]


def first_steps(path: Rollout, steps: int) -> Rollout:
    """Return the first *steps* instants of *path*."""
    return Rollout(*(value[:, :, :steps] for value in vars(path).values()))


def finer(path: Rollout, batch: SceneBatch) -> Rollout:
    """Return *path* with positions and headings interpolated linearly to four instants a step."""
    now = batch.pose[:, :, None]
    share = torch.arange(1, _BETWEEN + 1, device=path.xy.device, dtype=path.xy.dtype) / _BETWEEN

    def between(start: Tensor, change: Tensor) -> Tensor:
        shape = share.reshape(-1, *([1] * (start.dim() - 3)))
        return (start[:, :, :, None] + shape * change[:, :, :, None]).flatten(2, 3)

    xy = torch.cat((now[..., :2], path.xy[:, :, :-1]), dim=2)
    yaw = torch.cat((now[..., 2], path.yaw[:, :, :-1]), dim=2)
    speed = path.speed.repeat_interleave(_BETWEEN, dim=2)
    return Rollout(between(xy, path.xy - xy), between(yaw, wrap_angle(path.yaw - yaw)), speed, speed, speed)


def target_gap(path: Rollout, batch: SceneBatch, target: Tensor) -> Tensor:
    """Return gaps (B, A, T) in metres between the discs of each background vehicle and the target; below 0: contact.

    Large for the target itself, absent agents, pedestrians and parked vehicles.
    """
    steps = path.xy.shape[2]
    centres, radius = discs(path.xy, path.yaw, batch.size[:, :, None].expand(-1, -1, steps, -1))
    row = torch.arange(len(target), device=target.device)
    own, own_radius = centres[row, target], radius[row, target]  # (B, T, 5, 2), (B, T)
    apart = (centres[..., :, None, :] - own[:, None, :, None]).square().sum(-1).flatten(-2).amin(-1)
    gap = torch.sqrt(apart + 1e-9) - radius - own_radius[:, None]
    return torch.where(background(batch, target)[..., None], gap, 1e3)


def background(batch: SceneBatch, target: Tensor) -> Tensor:
    """Return (B, A) the vehicles that can attack: present, not parked, not the target."""
    agents = torch.arange(batch.agents, device=target.device)
    return batch.moved & batch.present & ~batch.parked & (agents != target[:, None])


def among_background(path: Rollout, batch: SceneBatch, target: Tensor) -> Tensor:
    """Return (B, T) overlap summed over pairs without the target; pairs that overlap at the beginning are left out."""
    agents = torch.arange(batch.agents, device=target.device)
    others = batch.present & (agents != target[:, None])
    moving = background(batch, target)
    overlap = pair_overlap(path, batch.size, others)
    before = pair_overlap(standing(batch), batch.size, others) > 0.0
    counted = moving[:, :, None] & others[:, None] & ~before.squeeze(-1)
    pairs = torch.where(counted[..., None], overlap, 0.0)
    pair_weight = torch.where((moving[:, :, None] & moving[:, None])[..., None], 0.5, 1.0)
    return (pair_weight * pairs).sum((1, 2))


def over_edge(path: Rollout, batch: SceneBatch, target: Tensor) -> Tensor:
    """Return (B, T) overlap with the road edge in excess of that at the beginning, summed over background vehicles."""
    over = off_road(path, batch) - off_road(standing(batch), batch)
    return torch.where(background(batch, target)[..., None], over.clamp(min=0.0), 0.0).sum(1)


def standing(batch: SceneBatch) -> Rollout:
    """Return the present states as a future of one instant."""
    pose = batch.pose[:, :, None]
    nothing = torch.zeros_like(pose[..., 0])
    return Rollout(pose[..., :2], pose[..., 2], pose[..., 3], nothing, nothing)
