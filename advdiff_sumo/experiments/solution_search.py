"""Searches for actions of the target that avoid all contacts, by gradient descent from many starts at once."""

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

_MARGIN_M = 0.3  # distance to others below which the contact loss begins
_LEARNING_RATE = 0.15
_OVERLAP_WEIGHT, _ROAD_WEIGHT, _EFFORT_WEIGHT = 10.0, 5.0, 0.01
_ACCEL_SCALE = 4.0  # raw acceleration per unit of the optimised variable
_SATURATION = 0.99  # largest share of a bound that is inverted by atanh
_BRAKES_MPS2 = (8.0, 5.0, 2.5, -2.0)
_SWERVES = ((0.5, 3.0), (-0.5, 3.0), (0.5, 0.0), (-0.5, 0.0))  # share of the largest curvature, deceleration
_SWERVE_STEPS = 2  # to one side, then as many to the other


@dataclass(frozen=True)
class Drives:
    """Actions of the target for K trajectories of S model steps: first the starts, then the optimised ones.

    Attributes:
        accel_mps2: (K, S) accelerations.
        curvature_1pm: (K, S) curvatures.
    """

    accel_mps2: FloatArray
    curvature_1pm: FloatArray


def search(
    prior: FrozenPrior, view: View, others: FloatArray, steps: int, draws: int, rounds: int, seed: int
) -> Drives:
    """Return candidate actions of the target, row 0 of *view*.

    Args:
        prior: traffic model whose samples are the first starts.
        view: the scene at the beginning.
        others: (A, steps, 4) states of all agents in the world's frame; NaN for absent ones.
        steps: number of model steps.
        draws: number of samples of the model; the first is its mean.
        rounds: steps of Adam.
        seed: of the samples.
    """
    batch = view.batch.to(prior.device)
    forced = _forced_others(others, view, prior.device)
    model = prior.traffic.options
    with torch.no_grad():
        accel, curvature = _starts(prior, batch, forced, steps, draws, seed)
        raw = _raw(accel, curvature, batch, model)
    start_rollout = _drive(raw, batch, model)
    optimised = _optimised(raw, batch, forced, rounds, model)
    rollouts = [start_rollout, *([_drive(optimised, batch, model)] if rounds else [])]
    accel = torch.cat([rollout.accel[:, 0] for rollout in rollouts])
    curvature = torch.cat([rollout.curvature[:, 0] for rollout in rollouts])
    return Drives(*(part.detach().cpu().numpy().astype(np.float64) for part in (accel, curvature)))


def _forced_others(others: FloatArray, view: View, device: torch.device) -> Forced:
    local = others - np.array([*view.now.xy_m[0, -1], 0.0, 0.0])
    is_present = np.asarray(np.isfinite(others).all(axis=-1))
    is_present[0] = False
    states = np.where(is_present[..., None], local, 0.0)
    return Forced(
        torch.as_tensor(states, dtype=torch.float32, device=device)[None],
        torch.as_tensor(is_present, device=device)[None],
    )


def _starts(
    prior: FrozenPrior, batch: SceneBatch, forced: Forced, steps: int, draws: int, seed: int
) -> tuple[Tensor, Tensor]:
    """Return accelerations and curvatures (K, S): samples of the model, then its mean with braking and swerving."""
    context: Context = prior.traffic.encoder(batch)
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn((draws, *context.prior.mean.shape[1:]), generator=generator).to(prior.device)
    noise[0] = 0.0
    z = context.prior.mean + torch.exp(0.5 * context.prior.logvar) * noise
    repeated_others = Forced(*(part.expand(draws, *part.shape[1:]) for part in (forced.states, forced.mask)))
    h = context.h.expand(draws, -1, -1)
    rollout: Rollout = prior.traffic.decoder(z, h, batch.repeat(draws), steps, repeated_others)
    accel, curvature = rollout.accel[:, 0], rollout.curvature[:, 0]
    manoeuvres = [(torch.full_like(accel[0], -brake), curvature[0]) for brake in _BRAKES_MPS2]
    for side, brake in _SWERVES:
        swerve = torch.zeros_like(curvature[0])
        swerve[:_SWERVE_STEPS], swerve[_SWERVE_STEPS : 2 * _SWERVE_STEPS] = side, -side
        swerve_curvature = _curvature_limit(batch, prior.traffic.options) * swerve
        manoeuvres.append((torch.full_like(accel[0], -brake), curvature[0] + swerve_curvature))
    manoeuvre_actions = [torch.stack(column) for column in zip(*manoeuvres, strict=True)]
    return torch.cat((accel, manoeuvre_actions[0])), torch.cat((curvature, manoeuvre_actions[1]))


def _curvature_limit(batch: SceneBatch, model: ModelOptions) -> Tensor:
    """Return the largest curvature of the target at its present speed."""
    saturating = torch.tensor([0.0, 1e3], device=batch.size.device)
    return controls(saturating, batch.pose[0, 0, 3], batch.size[0, 0, 0], model)[1]


def _raw(accel: Tensor, curvature: Tensor, batch: SceneBatch, model: ModelOptions) -> Tensor:
    """Return the unbounded variables (K, S, 2) of these actions (K, S); impossible actions are clipped."""
    bound = torch.where(accel > 0.0, model.accel_mps2, model.brake_mps2)
    raw_accel = bound * torch.atanh((accel / bound).clamp(-_SATURATION, _SATURATION)) / _ACCEL_SCALE
    speed = batch.pose[0, 0, 3].clamp(min=0.0).expand(len(accel))
    raw_curvature = []
    for k in range(accel.shape[1]):
        limit = controls(_full_steering(accel[:, k]), speed, batch.size[0, 0, 0], model)[1]
        raw_curvature.append(torch.atanh((curvature[:, k] / limit).clamp(-_SATURATION, _SATURATION)))
        speed = (speed + MODEL_STEP_S * accel[:, k]).clamp(min=0.0)
    return torch.stack((raw_accel, torch.stack(raw_curvature, dim=1)), dim=-1)


def _full_steering(like: Tensor) -> Tensor:
    return torch.stack((torch.zeros_like(like), torch.full_like(like, 1e3)), dim=-1)


def _drive(raw: Tensor, batch: SceneBatch, model: ModelOptions) -> Rollout:
    """Return the target's rollout (K, 1, S) under the unbounded variables *raw* (K, S, 2)."""
    pose = batch.pose[:, :1].expand(len(raw), -1, -1)
    xy, yaw, speed = pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)
    length, states = batch.size[:, :1, 0], []
    scale = torch.tensor([_ACCEL_SCALE, 1.0], device=raw.device)
    for k in range(raw.shape[1]):
        accel, curvature = controls((scale * raw[:, k])[:, None], speed, length, model)
        xy, yaw, speed = step(xy, yaw, speed, accel, curvature, MODEL_STEP_S)
        states.append((xy, yaw, speed, accel, curvature))
    return rollout_of(states)


def _optimised(raw: Tensor, batch: SceneBatch, forced: Forced, rounds: int, model: ModelOptions) -> Tensor:
    """Return *raw* after *rounds* steps of Adam on the losses of contact, leaving the road, and effort."""
    variables = raw.clone().requires_grad_(True)
    adam = torch.optim.Adam([variables], lr=_LEARNING_RATE)
    target_batch = batch.rows_of(slice(1)).repeat(len(raw))
    for _ in range(rounds):
        rollout = _drive(variables, batch, model)
        dense = halves(rollout, target_batch.pose)
        lateral_accel = rollout.curvature * rollout.speed.square()
        effort = (rollout.accel.square() + lateral_accel.square()).mean((1, 2))
        off_road_cost = off_road(dense, target_batch).sum((1, 2))
        loss = (
            _OVERLAP_WEIGHT * _contact(dense, batch, forced)
            + _ROAD_WEIGHT * off_road_cost
            + _EFFORT_WEIGHT * effort
        )
        (gradient,) = torch.autograd.grad(loss.sum(), variables)
        variables.grad = torch.where(torch.isfinite(gradient), gradient, 0.0)
        adam.step()
    return variables.detach()


def _contact(dense: Rollout, batch: SceneBatch, forced: Forced) -> Tensor:
    """Return the contact loss (K,): overlap with others, extended by the margin, summed over others and half steps."""
    if forced.mask.shape[1] < 2:
        return torch.zeros(len(dense.yaw), device=dense.yaw.device)
    is_present = forced.mask[:, 1:].repeat_interleave(2, dim=2)[0]  # (O, 2 S)
    other_states = forced.states
    other_speed = other_states[..., 3]  # accelerations and curvatures, the last two arguments, are not used
    other_rollout = Rollout(
        other_states[..., :2], other_states[..., 2], other_speed, other_speed, other_speed
    )
    other_rollout = halves(other_rollout, batch.pose)
    size = batch.size[0]
    target_discs, radius = discs(dense.xy, dense.yaw, size[0].expand(*dense.yaw.shape, 2))
    states = other_rollout.xy[0, 1:], other_rollout.yaw[0, 1:]
    other_discs, other_radius = discs(*states, size[1:, None].expand(*states[1].shape, 2))
    delta = target_discs[:, :, :, :, None] - other_discs[None, :, :, None]  # (K, O, 2 S, 5, 5, 2)
    gap = torch.sqrt(delta.square().sum(-1).flatten(-2).amin(-1) + 1e-9)
    overlap = (radius + other_radius + _MARGIN_M - gap).clamp(min=0.0)
    return torch.where(is_present, overlap, 0.0).sum((1, 2))
