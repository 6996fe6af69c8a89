"""Conversion to what is diffused: latents (the paper's method) or trajectories ("traj2traj", its ablation)."""

from __future__ import annotations

from typing import Literal, TypeAlias

import torch
from torch import Tensor, nn

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.gaussian import Gaussian
from advdiff_sumo.models.geometry import into_frame, rotate, wrap_angle
from advdiff_sumo.models.model_options import FUTURE_STEPS, MODEL_STEP_S, ModelOptions
from advdiff_sumo.models.traffic import TrafficModel

CodecName: TypeAlias = Literal["latent", "trajectory"]
_FLOOR = 0.05


class _Scaled(nn.Module):
    """Standardisation by statistics of the training data, which are stored in the checkpoint."""

    mean: Tensor
    std: Tensor

    def __init__(self, shape: tuple[int, int]) -> None:
        super().__init__()
        self.shape = shape
        self.register_buffer("mean", torch.zeros(shape))
        self.register_buffer("std", torch.ones(shape))

    def measure(self, raw: Tensor) -> None:
        """Set mean and deviation to those of *raw* (M, C, L)."""
        self.mean.copy_(raw.mean(0))
        self.std.copy_(raw.std(0).clamp(min=_FLOOR))

    def scale(self, raw: Tensor) -> Tensor:
        """Return *raw* (…, C, L) with zero mean and unit deviation over the training data."""
        return (raw - self.mean) / self.std

    def unscale(self, x: Tensor) -> Tensor:
        """Undo :meth:`scale`."""
        return x * self.std + self.mean


class LatentCodec(_Scaled):
    """Diffusion of latents: z̃⁰ is drawn from the posterior, the trajectory decoder turns it into futures."""

    def __init__(self, options: ModelOptions, model: TrafficModel) -> None:
        super().__init__((1, options.latent))
        self._model = (model,)  # in a tuple: the model's weights are not the codec's

    def raw(self, batch: SceneBatch, context: Context, generator: torch.Generator | None) -> Tensor:
        """Return a draw from q(z | τ, h), (B, A, 1, Z)."""
        posterior: Gaussian = self._model[0].posterior(batch, context.h)
        return posterior.sample(generator)[:, :, None]

    def decode(self, x: Tensor, context: Context, batch: SceneBatch) -> Rollout:
        """Return futures of the scaled latents *x*."""
        rollout: Rollout = self._model[0].decoder(self.unscale(x)[:, :, 0], context.h, batch)
        return rollout


class TrajectoryCodec(_Scaled):
    """Diffusion of futures: x, y and heading in the vehicle's present frame; no decoder, no bicycle model."""

    def __init__(self) -> None:
        super().__init__((3, FUTURE_STEPS))

    def raw(self, batch: SceneBatch, context: Context, generator: torch.Generator | None) -> Tensor:  # noqa: ARG002 - the contract
        """Return the future in own frames (B, A, 3, T); unknown instants keep the last known velocity."""
        now = batch.pose[:, :, None]
        filled = _filled(batch)
        xy = into_frame(filled[..., :2], now[..., :2], now[..., 2].expand(filled.shape[:-1]))
        turn = wrap_angle(filled[..., 2] - now[..., 2])
        return torch.cat((xy, turn[..., None]), dim=-1).transpose(-1, -2)

    def decode(self, x: Tensor, context: Context, batch: SceneBatch) -> Rollout:  # noqa: ARG002 - the contract
        """Return the trajectories in *x*; speeds, accelerations and curvatures by differences."""
        raw = self.unscale(x)
        now = batch.pose[:, :, None]
        yaw_now = now[..., 2].expand(raw.shape[:2] + raw.shape[3:])
        xy = now[..., :2] + rotate(raw[:, :, :2].transpose(-1, -2), yaw_now)
        yaw = yaw_now + raw[:, :, 2]
        steps = torch.diff(xy, dim=2, prepend=now[..., :2]) / MODEL_STEP_S
        ahead = torch.stack((torch.cos(yaw), torch.sin(yaw)), dim=-1)
        speed = (steps * ahead).sum(-1)
        accel = torch.diff(speed, dim=2, prepend=now[..., 3]) / MODEL_STEP_S
        turned = wrap_angle(torch.diff(yaw, dim=2, prepend=now[..., 2]))  # headings of x jump at ±π
        curvature = turned / (steps.norm(dim=-1) * MODEL_STEP_S).clamp(min=0.1)
        return Rollout(xy, yaw, speed, accel, curvature)


def _filled(batch: SceneBatch) -> Tensor:
    """Return the future (B, A, T, 4) with unknown instants at the last known velocity."""
    state, out = batch.pose, []
    for k in range(batch.future.shape[2]):
        yaw, speed = state[..., 2], state[..., 3]
        ahead = MODEL_STEP_S * speed[..., None] * torch.stack((torch.cos(yaw), torch.sin(yaw)), dim=-1)
        guess = torch.cat((state[..., :2] + ahead, state[..., 2:]), dim=-1)
        state = torch.where(batch.future_valid[:, :, k, None], batch.future[:, :, k], guess)
        out.append(state)
    return torch.stack(out, dim=2)
