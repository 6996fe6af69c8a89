"""Open loop: samples joint futures of windows, and measures them against the recorded ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.diffusion.sampler import Sampling
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.training import realism
from advdiff_sumo.training.denoiser_stage import diffused_samples
from advdiff_sumo.training.displacement import displacement, driving_mask

Draw = Callable[[SceneBatch, Context, int, torch.Generator], tuple[Rollout, int]]
"""Windows, their contexts, samples, random numbers → sampled futures, and how many there are of each window."""
Refine = Callable[[Tensor, Context, SceneBatch, int], Tensor]
"""Latents, contexts and windows of all samples, number of samples of a window → refined latents."""


def from_prior(bundle: Bundle) -> Draw:
    """Return a sampler of the prior of *bundle*."""

    def draw(
        batch: SceneBatch, context: Context, samples: int, generator: torch.Generator
    ) -> tuple[Rollout, int]:
        known = context.repeat(samples)
        z = known.prior.sample(generator)
        return bundle.traffic.decoder(z, known.h, batch.repeat(samples)), samples

    return draw


def sampling_of(bundle: Bundle, steps: int) -> Sampling:
    """Return the settings of unguided sampling of *bundle* in *steps* of DDIM, which were tuned on other windows.

    Sampling starts below the end of the schedule, where predictions of the data are mostly error. Latents for a
    closed-loop decoder are clipped to the range of its training (docs/experiments.md).
    """
    if bundle.options.codec != "latent":
        return Sampling(steps)
    closed = bundle.options.model.decoder == "closed-loop"
    return Sampling(steps, begin=0.95, clip=2.0) if closed else Sampling(steps, begin=0.95)


def by_diffusion(bundle: Bundle, steps: int, refine: Refine | None = None) -> Draw:
    """Return a sampler by *steps* of DDIM, see :func:`sampling_of`."""
    sampling = sampling_of(bundle, steps)

    def draw(
        batch: SceneBatch, context: Context, samples: int, generator: torch.Generator
    ) -> tuple[Rollout, int]:
        known, several = context.repeat(samples), batch.repeat(samples)
        drawn = diffused_samples(bundle, known, sampling, generator)
        if refine is not None:
            drawn = refine(drawn, known, several, samples)
        return bundle.codec.decode(drawn, known, several), samples

    return draw


@dataclass(frozen=True)
class JudgedWindows:
    """Measurements of W windows of A agents, with S joint samples each.

    Attributes:
        ade_m: (W, S, A) mean error over the known instants.
        fde_m: (W, S, A) error at the last known instant.
        spread_m: (W, A) mean distance of final positions over pairs of samples; 0 with one sample.
        driving: (W, A) vehicles that count: not parked, with a known future instant.
        hit: (W, S, A) driving vehicles whose box overlaps another one.
        off_road: (W, S, A) driving vehicles whose centre leaves the road.
        speed: (W, bins) counts of speeds.
        accel: (W, bins) counts of accelerations.
    """

    ade_m: Tensor
    fde_m: Tensor
    spread_m: Tensor
    driving: Tensor
    hit: Tensor
    off_road: Tensor
    speed: FloatArray
    accel: FloatArray

    @property
    def sfde_m(self) -> Tensor:
        """(W,) final error of the best joint sample, mean over its driving vehicles (minSFDE)."""
        total = torch.where(self.driving[:, None], self.fde_m, 0.0).sum(2)
        return total.amin(1) / self.driving.sum(1).clamp(min=1)


def judge(rollout: Rollout, several: SceneBatch, times: int, known: Tensor | None = None) -> JudgedWindows:
    """Return the measurements of joint futures.

    Args:
        rollout: futures; those of one window are *times* successive rows.
        several: the windows with recorded futures, repeated in the same way.
        times: samples of each window.
        known: (W S, A, T) instants at which an agent is present; None: agents present now stay.
    """
    if known is None:
        known = several.present[..., None].expand(rollout.yaw.shape)
    shape = (several.scenes // times, times, several.agents)
    errors = displacement(rollout, several)
    speed, accel = realism.histograms(rollout, several, times)
    return JudgedWindows(
        ade_m=errors.ade_m.reshape(shape),
        fde_m=errors.fde_m.reshape(shape),
        spread_m=realism.final_diversity(_last(rollout.xy, several).reshape(*shape, 2)),
        driving=driving_mask(several).reshape(shape)[:, 0],
        hit=realism.colliding(rollout, several, known).reshape(shape),
        off_road=realism.leaving_road(rollout, several, known).reshape(shape),
        speed=speed,
        accel=accel,
    )


def _last(xy: Tensor, batch: SceneBatch) -> Tensor:
    """Return positions (B, A, 2) at the last known instant."""
    steps = torch.arange(xy.shape[2], device=xy.device)
    last = torch.where(batch.future_valid, steps, 0).amax(-1)
    return xy.gather(2, last[..., None, None].expand(*last.shape, 1, 2)).squeeze(2)
