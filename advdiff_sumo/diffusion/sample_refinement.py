"""Refines samples: moves latents until the vehicles of a scene neither overlap nor leave the road.

The paper trains the networks with this penalty, P_coll (Sec. III-B, joint stage). Here it is minimised by gradient
descent on finished samples, with a term that holds each to its drawn latent, until it is 0. Vehicles without overlap
keep their latents to the bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from torch import Tensor

from advdiff_sumo.diffusion.adam import Adam
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import wrap_angle
from advdiff_sumo.models.losses import between_two, disc_pairs, off_road
from advdiff_sumo.models.model_options import FUTURE_STEPS

_WIDER_M = (0.8, 0.3)
_ROUND, _FIRST, _DISCS = 10, 2, 5

Decode: TypeAlias = Callable[[Tensor, Context, SceneBatch], Rollout]
"""Samples (B, A, C, L) with their scenes → futures, with gradients."""


@dataclass(frozen=True)
class RefinementOptions:
    """Settings of the refinement.

    Attributes:
        steps: most steps of Adam; a scene without penalty takes no further ones.
        rate: step size of Adam, in standard deviations of the latents.
        vehicles: weight of the five-disc overlap between vehicles.
        road: weight of the overlap with the road edge.
        keep: weight of the squared distance from the drawn latents.
    """

    steps: int = 120
    rate: float = 0.1
    vehicles: float = 2.0
    road: float = 4.0
    keep: float = 0.1


def fixed_neighbours_decode(codec: LatentCodec, decoder: FastDecoder) -> Decode:
    """Return an exact decoder whose gradient lacks the effect of a vehicle's latent on other vehicles.

    This gradient takes a fraction of the time of the exact one.
    """

    def decode(x: Tensor, context: Context, batch: SceneBatch) -> Rollout:
        z = codec.unscale(x)[:, :, 0]
        _, trace = decoder.whole(z.detach(), context.h, batch)
        everybody = torch.arange(batch.agents, device=z.device)
        return decoder.some(z, context.h, batch, everybody, FUTURE_STEPS, trace)

    return decode


def overlap_penalty(rollout: Rollout, batch: SceneBatch, how: RefinementOptions) -> Tensor:
    """Return the penalty (B, A) of futures: overlap with other agents and with the road edge.

    Boxes are enlarged a little, so that a penalty of 0 means a gap, and because discs leave out the corners. Overlap is
    also measured halfway between instants, so that no vehicle passes through another one unnoticed.
    """
    wide = torch.where(batch.present[..., None], batch.size + batch.size.new_tensor(_WIDER_M), batch.size)
    others = _until_contact(_overlap(_finer(rollout, batch), wide, batch.present)).sum((2, 3))
    road = off_road(rollout, replace(batch, size=wide)).sum(-1)
    return how.vehicles * others + how.road * road


def _finer(rollout: Rollout, batch: SceneBatch) -> Rollout:
    """Return *rollout* (B, A, T) with midpoints inserted before each instant, (B, A, 2 T)."""

    def halved(value: Tensor, now: Tensor) -> Tensor:
        before = torch.cat((now[:, :, None], value[:, :, :-1]), dim=2)
        return torch.stack((0.5 * (before + value), value), dim=3).flatten(2, 3)

    pose = batch.pose
    turned = wrap_angle(rollout.yaw - pose[:, :, None, 2])
    yaw = pose[:, :, None, 2] + halved(turned, torch.zeros_like(pose[..., 2]))
    nothing = torch.zeros_like(yaw)
    return Rollout(halved(rollout.xy, pose[..., :2]), yaw, nothing, nothing, nothing)


def _overlap(rollout: Rollout, size: Tensor, present: Tensor) -> Tensor:
    """Return (B, A, A, T) overlap of every two agents: 1 − d / (r_i + r_j), summed over all pairs of their discs.

    For deep overlaps the gradient of the nearest pair alone would not point to the shorter way out.
    """
    squared, reach = disc_pairs(rollout, size)
    overlap = (1.0 - torch.sqrt(squared + 1e-9) / reach[..., None]).clamp(min=0.0).sum(-1) / _DISCS
    return between_two(overlap, present)


def _until_contact(overlap: Tensor) -> Tensor:
    """Return *overlap* (B, A, A, T) at the first instants of overlap of each pair, 0 later.

    Later instants would push a vehicle that passes through another one out at the far side.
    """
    overlap_count = (overlap > 0.0).cumsum(-1)
    return torch.where(overlap_count <= _FIRST, overlap, 0.0)


def refine_samples(
    drawn: Tensor, decode: Decode, context: Context, batch: SceneBatch, how: RefinementOptions | None = None
) -> Tensor:
    """Return samples (B, A, C, L) near *drawn* whose futures collide less.

    Args:
        drawn: scaled samples of the denoiser.
        decode: from samples to futures.
        context: of the scenes.
        batch: the scenes; parked vehicles and agents without a plan keep their samples.
        how: weights and steps.
    """
    how = how or RefinementOptions()
    refined, x, origin, adam = drawn.clone(), drawn, drawn, Adam(how.rate)
    rows = torch.arange(batch.scenes, device=drawn.device)
    for step in range(1, how.steps + 1):
        wrong, gradient = _slope(x, origin, decode, context, batch, how)
        x = torch.where(wrong[:, None, None, None], adam.step(x, gradient), x)
        refined[rows] = x
        if step % _ROUND:
            continue
        left = torch.nonzero(wrong).ravel()
        if not len(left):
            break
        if len(left) < len(rows):
            rows, x, origin = rows[left], x[left], origin[left]
            batch, context = batch.rows(left), context.rows(left)
            adam.keep(left)
    return refined


def _slope(
    x: Tensor, drawn: Tensor, decode: Decode, context: Context, batch: SceneBatch, how: RefinementOptions
) -> tuple[Tensor, Tensor]:
    """Return which scenes (B,) have a penalty, and the gradient (B, A, C, L) of the objective."""
    free = (batch.moved & ~batch.parked).to(x.dtype)
    with torch.enable_grad():
        at = x.detach().requires_grad_(True)
        each = overlap_penalty(decode(at, context, batch), batch, how) * free
        gradient = torch.autograd.grad(each.sum(), at)[0].nan_to_num()
    gradient = (gradient + 2.0 * how.keep * (x - drawn)) * free[..., None, None]
    return each.detach().sum(1) > 0.0, gradient
