"""The bicycle model of ``core.bicycle`` on tensors, differentiable (Sec. III-B, "simplistic bicycle model")."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from advdiff_sumo.core.bicycle import WHEELBASE_PER_LENGTH
from advdiff_sumo.models.model_options import ModelOptions


def step(
    xy: Tensor, yaw: Tensor, speed: Tensor, accel: Tensor, curvature: Tensor, dt_s: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return pose and speed after *dt_s* along an exact arc; braking ends at zero speed.

    *xy* is (…, 2), all other tensors are (…,).
    """
    stop_s = torch.where(accel < 0.0, speed / (-accel).clamp(min=1e-6), math.inf)
    moving_s = stop_s.clamp(max=dt_s)
    travelled = speed * moving_s + 0.5 * accel * moving_s**2
    half = 0.5 * curvature * travelled
    chord = travelled * torch.sinc(half / math.pi)
    heading = yaw + half
    moved = xy + chord[..., None] * torch.stack((torch.cos(heading), torch.sin(heading)), dim=-1)
    return moved, yaw + 2.0 * half, (speed + accel * dt_s).clamp(min=0.0)


def controls(raw: Tensor, speed: Tensor, length: Tensor, options: ModelOptions) -> tuple[Tensor, Tensor]:
    """Return acceleration and curvature (…,) within the limits, from unbounded network outputs *raw* (…, 2).

    Curvature is bounded by the largest steering angle and by the lateral acceleration.
    """
    push, turn = raw[..., 0], raw[..., 1]
    up, down = options.accel_mps2, options.brake_mps2
    accel = torch.where(push > 0.0, up * torch.tanh(push / up), down * torch.tanh(push / down))
    geometric = math.tan(options.steer_rad) / (WHEELBASE_PER_LENGTH * length.clamp(min=0.5))
    grip = options.lateral_mps2 / speed.clamp(min=0.1) ** 2
    return accel, torch.minimum(geometric, grip) * torch.tanh(turn)
