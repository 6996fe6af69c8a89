"""Realism of joint samples: diversity, histograms of speed and acceleration, collisions, road departures."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.losses import edge_clearance
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.training.displacement import driving_mask
from advdiff_sumo.training.stage import Tally

SPEED_BINS = np.arange(0.0, 40.5, 0.5)
ACCEL_BINS = np.arange(-10.0, 10.25, 0.25)


def histograms(
    rollout: Rollout, batch: SceneBatch, times: int = 1
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (W, bins) counts of speeds and accelerations over the known instants of driving vehicles.

    Accelerations are differences of speeds, for logs and models; values beyond the range count in the outermost bins.

    Args:
        rollout: futures of W windows; those of one window are *times* successive rows.
        batch: the windows, repeated in the same way.
        times: samples of each window.
    """
    driven = driving_mask(batch)[..., None]
    before = torch.cat((batch.pose[..., 3:4], rollout.speed[..., :-1]), dim=-1)
    accel = (rollout.speed - before) / MODEL_STEP_S
    known, changes = driven & batch.future_valid, driven & known_steps(batch)
    return _counts(rollout.speed, known, SPEED_BINS, times), _counts(accel, changes, ACCEL_BINS, times)


def known_steps(batch: SceneBatch) -> Tensor:
    """Return (B, A, T) the instants of the future that are known and follow a known instant."""
    now = torch.ones_like(batch.future_valid[..., :1])
    return batch.future_valid & torch.cat((now, batch.future_valid[..., :-1]), dim=-1)


def final_diversity(last: Tensor) -> Tensor:
    """Return (B, A) the mean distance of final positions over pairs of samples; 0 with one sample.

    Args:
        last: (B, S, A, 2) final positions in S samples.
    """
    samples = last.shape[1]
    apart: Tensor = (last[:, :, None] - last[:, None]).norm(dim=-1).sum((1, 2))
    return apart / max(1, samples * (samples - 1))


def faults(rollout: Rollout, batch: SceneBatch, known: Tensor) -> Tally:
    """Return tallies of driving vehicles that collide or leave the road at instants *known* (B, A, T)."""
    total = float(driving_mask(batch).sum())
    return {
        "collision_rate": (float(colliding(rollout, batch, known).sum()), total),
        "off_road_rate": (float(leaving_road(rollout, batch, known).sum()), total),
    }


def colliding(rollout: Rollout, batch: SceneBatch, known: Tensor) -> Tensor:
    """Return (B, A) driving vehicles whose box overlaps another one at some instant, but not now.

    Args:
        rollout: futures.
        batch: the scenes.
        known: (B, A, T) instants at which an agent is present.
    """
    touch = _overlap(rollout.xy, rollout.yaw, batch.size) & known[:, :, None] & known[:, None]
    pose = batch.pose[:, :, None]
    now = _overlap(pose[..., :2], pose[..., 2], batch.size).squeeze(-1)
    other = ~torch.eye(batch.agents, dtype=torch.bool, device=known.device)
    return (touch.any(-1) & ~now & other).any(-1) & driving_mask(batch)


def leaving_road(rollout: Rollout, batch: SceneBatch, known: Tensor) -> Tensor:
    """Return (B, A) driving vehicles whose centre is on the road now and beyond its edge at some known instant."""
    now = edge_clearance(batch.pose[:, :, None, :2], batch).squeeze(-1) > 0.0
    off = (edge_clearance(rollout.xy, batch) < 0.0) & known
    return off.any(-1) & now & driving_mask(batch)


def _overlap(xy: Tensor, yaw: Tensor, size: Tensor) -> Tensor:
    """Return (B, A, A, T) whether boxes overlap, by their four separating axes."""
    ahead = torch.stack((torch.cos(yaw), torch.sin(yaw)), dim=-1)
    left = torch.stack((-ahead[..., 1], ahead[..., 0]), dim=-1)
    half = 0.5 * size[:, :, None, :, None]  # (B, A, 1, 2, 1)
    edges = half * torch.stack((ahead, left), dim=-2)  # (B, A, T, 2, 2): half edges
    delta = xy[:, None] - xy[:, :, None]  # (B, A, A, T, 2)
    apart = torch.zeros(delta.shape[:-1], dtype=torch.bool, device=xy.device)
    for axis in (ahead[:, :, None], left[:, :, None], ahead[:, None], left[:, None]):
        reach = (edges[:, :, None] * axis[..., None, :]).sum(-1).abs().sum(-1)
        reach = reach + (edges[:, None] * axis[..., None, :]).sum(-1).abs().sum(-1)
        apart = apart | ((delta * axis).sum(-1).abs() > reach)
    return ~apart


def _counts(values: Tensor, known: Tensor, bins: NDArray[np.float64], times: int) -> NDArray[np.float64]:
    windows = len(values) // times
    inside = np.clip(values.double().cpu().numpy(), bins[0], bins[-1]).reshape(windows, -1)
    rows = zip(inside, known.cpu().numpy().reshape(windows, -1), strict=True)
    return np.stack([np.histogram(row[mask], bins)[0] for row, mask in rows]).astype(np.float64)
