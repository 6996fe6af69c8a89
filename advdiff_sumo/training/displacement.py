"""Displacement errors of joint futures, over the vehicles that are not parked."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout


@dataclass(frozen=True)
class Displacement:
    """Errors of each vehicle.

    Attributes:
        ade_m: (B, A) mean distance over the known instants.
        fde_m: (B, A) distance at the last known instant.
        mask: (B, A) vehicles that count: not parked, with a known future instant.
    """

    ade_m: Tensor
    fde_m: Tensor
    mask: Tensor

    def ade_sum(self) -> tuple[float, float]:
        """Return the sum of the mean errors and the number of vehicles."""
        return masked_sum(self.ade_m, self.mask)

    def fde_sum(self) -> tuple[float, float]:
        """Return the sum of the final errors and the number of vehicles."""
        return masked_sum(self.fde_m, self.mask)


def driving_mask(batch: SceneBatch) -> Tensor:
    """Return (B, A) vehicles that are not parked and have a known future instant."""
    return batch.moved & ~batch.parked & batch.future_valid.any(-1)


def displacement(rollout: Rollout, batch: SceneBatch) -> Displacement:
    """Return the errors of *rollout* relative to the recorded future."""
    known = batch.future_valid
    distance = (rollout.xy - batch.future[..., :2]).norm(dim=-1)  # (B, A, T)
    distance = torch.where(known, distance, 0.0)
    ade = distance.sum(-1) / known.sum(-1).clamp(min=1)
    steps = torch.arange(known.shape[-1], device=known.device)
    last = torch.where(known, steps, 0).amax(-1, keepdim=True)
    return Displacement(ade, distance.gather(-1, last).squeeze(-1), driving_mask(batch))


def logged_rollout(batch: SceneBatch) -> Rollout:
    """Return the recorded future as a rollout; unknown instants are 0."""
    future, nothing = batch.future, torch.zeros_like(batch.future[..., 0])
    return Rollout(future[..., :2], future[..., 2], future[..., 3], nothing, nothing)


def masked_sum(value: Tensor, mask: Tensor) -> tuple[float, float]:
    """Return the sum of *value* over *mask*, and the size of the mask."""
    return float(torch.where(mask, value, 0.0).sum()), float(mask.sum())
