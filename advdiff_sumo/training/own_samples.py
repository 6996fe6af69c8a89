"""Penalties and figures of a traffic model's own samples: overlap, road, lanes, following distance, progress."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from advdiff_sumo.diffusion.sample_refinement import RefinementOptions, overlap_penalty
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.decoder import Decoder, Rollout
from advdiff_sumo.models.losses import masked_mean
from advdiff_sumo.training import realism
from advdiff_sumo.training.displacement import driving_mask, logged_rollout
from advdiff_sumo.training.driving_penalties import following_penalty, lane_distance, travelled_m
from advdiff_sumo.training.presets import DecoderOptions
from advdiff_sumo.training.stage import Tally


def decoded_pair(
    decoder: Decoder, latents: tuple[Tensor, Tensor], h: tuple[Tensor, Tensor], batch: SceneBatch
) -> tuple[Rollout, Rollout]:
    """Return the futures of two sets of latents (B, A, Z) and embeddings (B, A, D), decoded in one pass."""
    z, state = (torch.stack(pair, dim=1).flatten(0, 1) for pair in (latents, h))
    rollout = decoder(z, state, batch.repeat(2))
    first, second = (Rollout(**{k: v[i::2] for k, v in vars(rollout).items()}) for i in (0, 1))
    return first, second


def sample_judge(compiled: bool) -> Callable[[Rollout, SceneBatch, DecoderOptions], dict[str, Tensor]]:
    """Return :func:`sample_terms`, by ``torch.compile`` if *compiled*."""
    return torch.compile(sample_terms, dynamic=False) if compiled else sample_terms


def sample_terms(free: Rollout, batch: SceneBatch, options: DecoderOptions) -> dict[str, Tensor]:
    """Return the weighted penalties of sampled futures *free*, by name."""
    is_driven = batch.moved & ~batch.parked
    how = RefinementOptions(vehicles=options.vehicles, road=options.road)
    way, truth = (
        torch.where(is_driven, travelled_m(r, batch), 0.0).sum() for r in (free, logged_rollout(batch))
    )
    ratio = way / truth.clamp(min=1.0)
    return {
        "overlap_penalty": masked_mean(overlap_penalty(free, batch, how), is_driven),
        "lane": options.lane * masked_mean(lane_distance(free, batch), is_driven),
        "following": options.following * masked_mean(following_penalty(free, batch), is_driven),
        "progress": options.progress * (ratio - 1.0).square(),
    }


@torch.no_grad()
def faults(free: Rollout, batch: SceneBatch) -> Tally:
    """Return the collisions, road departures and driven distances of sampled futures."""
    is_present, is_driven = batch.present[..., None].expand(free.yaw.shape), driving_mask(batch)
    driven, truth = (float(travelled_m(r, batch)[is_driven].sum()) for r in (free, logged_rollout(batch)))
    return realism.faults(free, batch, is_present) | {"travelled": (driven, truth)}
