"""Draws the joint future of a view: DDIM over latents, with or without a guide, then the decoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.diffusion.guides import Guidance
from advdiff_sumo.diffusion.sampler import sample
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.gaussian import draw
from advdiff_sumo.models.losses import off_road, pair_overlap
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.diffusion.diffusion_networks import Networks
from advdiff_sumo.traffic.diffusion.diffusion_options import DiffusionOptions
from advdiff_sumo.traffic.diffusion.guidance import Scenes, guidance
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.pace import with_pace

_FASTEST_MPS = 40.0


def draw_plan(
    networks: Networks,
    options: DiffusionOptions,
    view: View,
    noise: Mapping[str, FloatArray],
    previous_shifts: Mapping[str, FloatArray],
    seed: int,
) -> Drawn:
    """Return a joint future of *view*.

    Args:
        networks: the trained networks.
        options: options of the policy.
        view: the scene as the networks see it.
        noise: id → starting noise of the previous plan.
        previous_shifts: id → shift of a vehicle guided in the previous plan. It is preferred as an attacker if it
            still can attack, and its shift continues from there.
        seed: seed of the random numbers, which are drawn on the CPU.
    """
    generator = torch.Generator().manual_seed(seed)
    batch = view.batch.to(networks.device)
    with torch.no_grad():
        context = encode(networks, batch)
    start = _start_noise(options, view, noise, networks.codec.shape, generator)
    repeated, repeated_context = batch, context
    if options.samples > 1:
        repeated, repeated_context = batch.repeat(options.samples), context.repeat(options.samples)
    guide: Guidance | None = None
    attackers: tuple[str, ...] = ()
    if options.guided:
        scenes = Scenes(batch, repeated, context)
        guide, attackers = guidance(networks, options, view, scenes, previous_shifts)
    x = sample(
        networks.denoiser(repeated_context),
        options.noise * start.to(networks.device),
        networks.schedule,
        networks.sampling,
        generator,
        guide,
    )
    natural = torch.tensor([name not in attackers for name in view.ids], device=networks.device)
    x = with_pace(x, networks.faster, repeated.pose[..., 3], options.briskness * natural)
    rollout = decode(networks, x, repeated_context, repeated)
    rows = [view.ids.index(name) for name in attackers]
    best = most_plausible(rollout, repeated, rows) if options.samples > 1 else 0
    start_noise = start[best].flatten(1).numpy().astype(np.float64)
    return Drawn(
        rollout=_single_scene(rollout, best),
        noise={name: start_noise[row] for row, name in enumerate(view.ids)},
        attackers=attackers,
        latents=x[best].flatten(1),
        shifts=_shifts(guide, view, attackers, best),
    )


@torch.no_grad()
def encode(networks: Networks, batch: SceneBatch) -> Context:
    """Return the embeddings and the prior of *batch*, without gradients."""
    context: Context = networks.bundle.traffic.encoder(batch)
    return context


def decode(networks: Networks, x: Tensor, context: Context, batch: SceneBatch) -> Rollout:
    """Return the futures of scaled samples *x* (B, A, C, L)."""
    if isinstance(networks.codec, LatentCodec):
        return networks.decoder.whole(networks.codec.unscale(x)[:, :, 0], context.h, batch)[0]
    return without_jumps(networks.codec.decode(x, context, batch), batch)


def without_jumps(rollout: Rollout, batch: SceneBatch) -> Rollout:
    """Return *rollout* with each step shortened to what ``_FASTEST_MPS`` allows.

    Diffused trajectories obey no vehicle model, and a run refuses a plan with a jump.
    """
    strides = torch.diff(rollout.xy, dim=2, prepend=batch.pose[:, :, None, :2])
    share = (_FASTEST_MPS * MODEL_STEP_S / strides.norm(dim=-1, keepdim=True).clamp(min=1e-6)).clamp(max=1.0)
    speed = rollout.speed.clamp(0.0, _FASTEST_MPS)
    return replace(rollout, xy=batch.pose[:, :, None, :2] + (share * strides).cumsum(2), speed=speed)


def _start_noise(
    options: DiffusionOptions,
    view: View,
    noise: Mapping[str, FloatArray],
    shape: tuple[int, int],
    generator: torch.Generator,
) -> Tensor:
    """Return standard normal noise (samples, A, C, L); the first sample keeps a share of the previous plan's."""
    start = draw(torch.zeros(options.samples, len(view.ids), *shape), generator)
    share = options.persistence
    for row, name in enumerate(view.ids):
        if name in noise:
            previous = torch.from_numpy(noise[name]).to(start.dtype)
            start[0, row] = share * previous.reshape(shape) + (1.0 - share**2) ** 0.5 * start[0, row]
    return start


def _shifts(
    guide: Guidance | None, view: View, attackers: tuple[str, ...], best: int
) -> dict[str, FloatArray]:
    if guide is None or guide.last_shift is None:
        return {}
    shift = guide.last_shift[best].cpu().numpy().astype(np.float64)
    return {name: shift[view.ids.index(name)] for name in attackers}


@torch.no_grad()
def most_plausible(rollout: Rollout, batch: SceneBatch, attackers: Sequence[int]) -> int:
    """Return the index of the sample in which vehicles overlap and leave the road least.

    Args:
        rollout: samples (B, A, T) of one scene, the target first.
        batch: the scene, repeated B times.
        attackers: rows of the guided vehicles; their overlap with the target does not count.
    """
    overlap, rows = pair_overlap(rollout, batch.size, batch.present), list(attackers)
    overlap[:, 0, rows] = overlap[:, rows, 0] = 0.0
    overlaps = overlap.amax(dim=(2, 3)).sum(1)
    return int((overlaps + off_road(rollout, batch).amax(2).sum(1)).argmin())


def _single_scene(rollout: Rollout, scene: int) -> Rollout:
    cut = slice(scene, scene + 1)
    return Rollout(
        rollout.xy[cut], rollout.yaw[cut], rollout.speed[cut], rollout.accel[cut], rollout.curvature[cut]
    )
