"""Searches the target's actions for a drive that touches nobody, by gradients from many starts at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Forced, Rollout, rollout_of
from advdiff_sumo.models.losses import discs, off_road
from advdiff_sumo.models.model_options import MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.tensor_bicycle import controls, step
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.baselines.baseline_networks import FrozenPrior
from advdiff_sumo.traffic.baselines.baseline_policy import halves

_MARGIN_M = 0.3
_RATE = 0.15
_OVERLAP, _ROAD, _EFFORT = 10.0, 5.0, 0.01
_PUSH = 4.0  # raw acceleration of a searched number of 1
_ALMOST = 0.99
_BRAKES_MPS2 = (8.0, 5.0, 2.5, -2.0)
_SWERVES = ((0.5, 3.0), (-0.5, 3.0), (0.5, 0.0), (-0.5, 0.0))
_SWERVE_STEPS = 2


@dataclass(frozen=True)
class Drives:
    """Actions of the target, K drives of S model steps; the starts first, then where the search led from each.

    Attributes:
        accel_mps2: (K, S) accelerations.
        curvature_1pm: (K, S) curvatures.
    """

    accel_mps2: FloatArray
    curvature_1pm: FloatArray


def search(
    prior: FrozenPrior, view: View, others: FloatArray, steps: int, draws: int, rounds: int, seed: int
) -> Drives:
    """Return drives of the target, row 0 of *view*, the more likely free of contact the later.

    Args:
        prior: traffic model that gives the first starts.
        view: the scene at the beginning.
        others: (A, steps, 4) what everybody does in the world's frame; NaN for who is not there.
        steps: model steps to drive.
        draws: starts from the model; the first is its mean.
        rounds: of Adam.
        seed: of the draws.
    """
    batch = view.batch.to(prior.device)
    forced = _forced(others, view, prior.device)
    model = prior.traffic.options
    with torch.no_grad():
        accel, curvature = _starts(prior, batch, forced, steps, draws, seed)
        raw = _raw(accel, curvature, batch, model)
    begun = _drive(raw, batch, model)
    optimised = _optimised(raw, batch, forced, rounds, model)
    both = [begun, *([_drive(optimised, batch, model)] if rounds else [])]
    accel = torch.cat([x.accel[:, 0] for x in both])
    curvature = torch.cat([x.curvature[:, 0] for x in both])
    return Drives(*(x.detach().cpu().numpy().astype(np.float64) for x in (accel, curvature)))


def _forced(others: FloatArray, view: View, device: torch.device) -> Forced:
    local = others - np.array([*view.now.xy_m[0, -1], 0.0, 0.0])
    there = np.asarray(np.isfinite(others).all(axis=-1))
    there[0] = False
    states = np.where(there[..., None], local, 0.0)
    return Forced(
        torch.as_tensor(states, dtype=torch.float32, device=device)[None],
        torch.as_tensor(there, device=device)[None],
    )


def _starts(
    prior: FrozenPrior, batch: SceneBatch, forced: Forced, steps: int, draws: int, seed: int
) -> tuple[Tensor, Tensor]:
    """Return accelerations and curvatures (K, S): draws of the model, then its mean braked and swerved."""
    context: Context = prior.traffic.encoder(batch)
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn((draws, *context.prior.mean.shape[1:]), generator=generator).to(prior.device)
    noise[0] = 0.0
    z = context.prior.mean + torch.exp(0.5 * context.prior.logvar) * noise
    many = Forced(*(part.expand(draws, *part.shape[1:]) for part in (forced.states, forced.mask)))
    h = context.h.expand(draws, -1, -1)
    rollout: Rollout = prior.traffic.decoder(z, h, batch.repeat(draws), steps, many)
    accel, curvature = rollout.accel[:, 0], rollout.curvature[:, 0]
    manoeuvres = [(torch.full_like(accel[0], -brake), curvature[0]) for brake in _BRAKES_MPS2]
    for side, brake in _SWERVES:
        swerve = torch.zeros_like(curvature[0])
        swerve[:_SWERVE_STEPS], swerve[_SWERVE_STEPS : 2 * _SWERVE_STEPS] = side, -side
        bend = _limit(batch, prior.traffic.options) * swerve
        manoeuvres.append((torch.full_like(accel[0], -brake), curvature[0] + bend))
    more = [torch.stack(column) for column in zip(*manoeuvres, strict=True)]
    return torch.cat((accel, more[0])), torch.cat((curvature, more[1]))


def _limit(batch: SceneBatch, model: ModelOptions) -> Tensor:
    """Return the largest curvature of the target at its speed now."""
    big = torch.tensor([0.0, 1e3], device=batch.size.device)
    return controls(big, batch.pose[0, 0, 3], batch.size[0, 0, 0], model)[1]


def _raw(accel: Tensor, curvature: Tensor, batch: SceneBatch, model: ModelOptions) -> Tensor:
    """Return (K, S, 2) unbounded numbers that lead to these actions, as far as they are possible."""
    bound = torch.where(accel > 0.0, model.accel_mps2, model.brake_mps2)
    push = bound * torch.atanh((accel / bound).clamp(-_ALMOST, _ALMOST)) / _PUSH
    speed = batch.pose[0, 0, 3].clamp(min=0.0).expand(len(accel))
    turns = []
    for k in range(accel.shape[1]):
        limit = controls(_most(accel[:, k]), speed, batch.size[0, 0, 0], model)[1]
        turns.append(torch.atanh((curvature[:, k] / limit).clamp(-_ALMOST, _ALMOST)))
        speed = (speed + MODEL_STEP_S * accel[:, k]).clamp(min=0.0)
    return torch.stack((push, torch.stack(turns, dim=1)), dim=-1)


def _most(like: Tensor) -> Tensor:
    return torch.stack((torch.zeros_like(like), torch.full_like(like, 1e3)), dim=-1)


def _drive(raw: Tensor, batch: SceneBatch, model: ModelOptions) -> Rollout:
    """Return the target's future (K, 1, S) under *raw* (K, S, 2)."""
    pose = batch.pose[:, :1].expand(len(raw), -1, -1)
    xy, yaw, speed = pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)
    length, states = batch.size[:, :1, 0], []
    scale = torch.tensor([_PUSH, 1.0], device=raw.device)
    for k in range(raw.shape[1]):
        accel, curvature = controls((scale * raw[:, k])[:, None], speed, length, model)
        xy, yaw, speed = step(xy, yaw, speed, accel, curvature, MODEL_STEP_S)
        states.append((xy, yaw, speed, accel, curvature))
    return rollout_of(states)


def _optimised(raw: Tensor, batch: SceneBatch, forced: Forced, rounds: int, model: ModelOptions) -> Tensor:
    """Return *raw* after *rounds* of Adam on contact, leaving the road, and effort."""
    free = raw.clone().requires_grad_(True)
    adam = torch.optim.Adam([free], lr=_RATE)
    own = batch.rows_of(slice(1)).repeat(len(raw))
    for _ in range(rounds):
        rollout = _drive(free, batch, model)
        dense = halves(rollout, own.pose)
        across = rollout.curvature * rollout.speed.square()
        effort = (rollout.accel.square() + across.square()).mean((1, 2))
        off = off_road(dense, own).sum((1, 2))
        loss = _OVERLAP * _contact(dense, batch, forced) + _ROAD * off + _EFFORT * effort
        (gradient,) = torch.autograd.grad(loss.sum(), free)
        free.grad = torch.where(torch.isfinite(gradient), gradient, 0.0)
        adam.step()
    return free.detach()


def _contact(dense: Rollout, batch: SceneBatch, forced: Forced) -> Tensor:
    """Return (K,) how far the target is inside others, or nearer than the margin, summed over half steps."""
    if forced.mask.shape[1] < 2:
        return torch.zeros(len(dense.yaw), device=dense.yaw.device)
    there = forced.mask[:, 1:].repeat_interleave(2, dim=2)[0]  # (O, 2 S)
    given = forced.states
    theirs = Rollout(given[..., :2], given[..., 2], given[..., 3], given[..., 3], given[..., 3])
    theirs = halves(theirs, batch.pose)
    size = batch.size[0]
    mine, radius = discs(dense.xy, dense.yaw, size[0].expand(*dense.yaw.shape, 2))
    states = theirs.xy[0, 1:], theirs.yaw[0, 1:]
    yours, reach = discs(*states, size[1:, None].expand(*states[1].shape, 2))
    delta = mine[:, :, :, :, None] - yours[None, :, :, None]  # (K, O, 2 S, 5, 5, 2)
    near = torch.sqrt(delta.square().sum(-1).flatten(-2).amin(-1) + 1e-9)
    inside = (radius + reach + _MARGIN_M - near).clamp(min=0.0)
    return torch.where(there, inside, 0.0).sum((1, 2))
