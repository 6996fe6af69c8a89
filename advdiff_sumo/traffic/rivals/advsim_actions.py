"""What AdvSim searches over: changes of an initial action sequence, feasible by construction.

A change is a number in [−1, 1] for each acceleration and curvature. The bicycle model's limits hold for every
result, and so do limits on how fast actions change, but where the initial sequence itself goes beyond the latter:
there they are as wide as it needs, so that no change gives the initial sequence exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.core.bicycle import WHEELBASE_PER_LENGTH
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bicycle import step
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.geometry import wrap_angle
from advdiff_sumo.models.options import MODEL_STEP_S, ModelOptions
from advdiff_sumo.traffic.rivals.options import AdvSimOptions

_CRAWL_MPS = 2.0


@dataclass(frozen=True)
class Initial:
    """R attackers before the search.

    Attributes:
        pose: (R, 4) x, y, yaw, speed now.
        length: (R,) of their boxes.
        accel: (R, T) initial accelerations.
        curvature: (R, T) initial curvatures.
        last: (R, 2) acceleration and curvature until now.
    """

    pose: Tensor
    length: Tensor
    accel: Tensor
    curvature: Tensor
    last: Tensor


def initial_of(rollout: Rollout, batch: SceneBatch, rows: Tensor) -> Initial:
    """Return the attackers *rows* (R,) of a scene that goes on as *rollout* (1, A, T)."""
    past, known = batch.past[0, rows], batch.past_valid[0, rows]
    accel, curvature = rollout.accel[0, rows], rollout.curvature[0, rows]
    driven = (past[:, -1, :2] - past[:, -2, :2]).norm(dim=-1)
    turned = wrap_angle(past[:, -1, 2] - past[:, -2, 2])
    before = torch.stack(
        ((past[:, -1, 3] - past[:, -2, 3]) / MODEL_STEP_S, turned / driven.clamp(min=0.5)), dim=-1
    )
    first = torch.stack((accel[:, 0], curvature[:, 0]), dim=-1)
    last = torch.where(known[:, -2:].all(-1)[:, None], before, first)
    return Initial(batch.pose[0, rows], batch.size[0, rows, 0], accel, curvature, last)


def driven(changes: Tensor, initial: Initial, options: AdvSimOptions, model: ModelOptions) -> Rollout:
    """Return the futures (P, R, T) of *changes* (P, R, H, 2), H at most T; afterwards the initial actions again."""
    count, steps = len(changes), initial.accel.shape[1]
    pose = initial.pose.expand(count, -1, -1)
    xy, yaw, speed = pose[..., :2], pose[..., 2], pose[..., 3].clamp(min=0.0)
    accel, curvature = initial.last[:, 0].expand(count, -1), initial.last[:, 1].expand(count, -1)
    states = []
    for k in range(steps):
        wish = changes[:, :, k] if k < changes.shape[2] else torch.zeros_like(changes[:, :, 0])
        accel = _accel(k, wish[..., 0], accel, initial, options, model)
        curvature = _curvature(k, wish[..., 1], curvature, speed, initial, options, model)
        xy, yaw, speed = step(xy, yaw, speed, accel, curvature, MODEL_STEP_S)
        states.append((xy, yaw, speed, accel, curvature))
    return Rollout(*(torch.stack(column, dim=2) for column in zip(*states, strict=True)))


def _accel(
    k: int, wish: Tensor, before: Tensor, initial: Initial, options: AdvSimOptions, model: ModelOptions
) -> Tensor:
    wanted = initial.accel[:, k] + options.accel_mps2 * wish
    most = torch.maximum(
        _jump(k, initial.accel, initial.last[:, 0]), _full(wish, options.jerk_mps3 * MODEL_STEP_S)
    )
    wanted = torch.minimum(torch.maximum(wanted, before - most), before + most)
    return wanted.clamp(-model.brake_mps2, model.accel_mps2)


def _curvature(
    k: int,
    wish: Tensor,
    before: Tensor,
    speed: Tensor,
    initial: Initial,
    options: AdvSimOptions,
    model: ModelOptions,
) -> Tensor:
    limit = largest_curvature(speed, initial.length, model)
    wanted = initial.curvature[:, k] + options.steer_share * limit * wish
    swerve = options.swerve_mps3 * MODEL_STEP_S / speed.clamp(min=_CRAWL_MPS) ** 2
    most = torch.maximum(_jump(k, initial.curvature, initial.last[:, 1]).expand_as(swerve), swerve)
    wanted = torch.minimum(torch.maximum(wanted, before - most), before + most)
    return torch.minimum(torch.maximum(wanted, -limit), limit)


def largest_curvature(speed: Tensor, length: Tensor, model: ModelOptions) -> Tensor:
    """Return the bound that steering angle and lateral acceleration set at *speed*."""
    geometric = math.tan(model.steer_rad) / (WHEELBASE_PER_LENGTH * length.clamp(min=0.5))
    return torch.minimum(geometric, model.lateral_mps2 / speed.clamp(min=0.1) ** 2)


def _jump(k: int, values: Tensor, last: Tensor) -> Tensor:
    """Return (R,) how much the initial sequence itself changes at step *k*."""
    return (values[:, k] - (values[:, k - 1] if k else last)).abs()


def _full(like: Tensor, value: float) -> Tensor:
    return torch.full_like(like, value)
