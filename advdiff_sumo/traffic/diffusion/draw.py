"""Draws the joint future of a view: DDIM over latents, guided or not, then the decoder."""

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
    before: Mapping[str, FloatArray],
    seed: int,
) -> Drawn:
    """Return a joint future of *view*.

    Args:
        networks: the trained networks.
        options: of the policy.
        view: what they see.
        noise: id → starting noise of the last plan.
        before: id → shift of who was guided last; they stay where they still can do something, and go on from there.
        seed: of the random numbers, which are drawn on the CPU.
    """
    generator = torch.Generator().manual_seed(seed)
    batch = view.batch.to(networks.device)
    with torch.no_grad():
        context = encode(networks, batch)
    start = _start(options, view, noise, networks.codec.shape, generator)
    many, several = batch, context
    if options.samples > 1:
        many, several = batch.repeat(options.samples), context.repeat(options.samples)
    guide: Guidance | None = None
    chosen: tuple[str, ...] = ()
    if options.guided:
        guide, chosen = guidance(networks, options, view, Scenes(batch, many, context), before)
    x = sample(
        networks.denoiser(several),
        options.noise * start.to(networks.device),
        networks.schedule,
        networks.sampling,
        generator,
        guide,
    )
    natural = torch.tensor([name not in chosen for name in view.ids], device=networks.device)
    x = with_pace(x, networks.faster, many.pose[..., 3], options.briskness * natural)
    rollout = decode(networks, x, several, many)
    rows = [view.ids.index(name) for name in chosen]
    best = most_plausible(rollout, many, rows) if options.samples > 1 else 0
    kept = start[best].flatten(1).numpy().astype(np.float64)
    return Drawn(
        rollout=_only(rollout, best),
        noise={name: kept[row] for row, name in enumerate(view.ids)},
        attackers=chosen,
        latents=x[best].flatten(1),
        shifts=_shifts(guide, view, chosen, best),
    )


@torch.no_grad()
def encode(networks: Networks, batch: SceneBatch) -> Context:
    """Return embeddings and prior of *batch*, without gradients."""
    context: Context = networks.bundle.traffic.encoder(batch)
    return context


def decode(networks: Networks, x: Tensor, context: Context, batch: SceneBatch) -> Rollout:
    """Return the futures of scaled samples *x* (B, A, C, L)."""
    if isinstance(networks.codec, LatentCodec):
        return networks.decoder.whole(networks.codec.unscale(x)[:, :, 0], context.h, batch)[0]
    return without_jumps(networks.codec.decode(x, context, batch), batch)


def without_jumps(rollout: Rollout, batch: SceneBatch) -> Rollout:
    """Return *rollout* with moves of an instant no longer than ``_FASTEST_MPS`` makes them.

    Trajectories that are diffused know no vehicle; a plan with a jump would be refused.
    """
    moves = torch.diff(rollout.xy, dim=2, prepend=batch.pose[:, :, None, :2])
    share = (_FASTEST_MPS * MODEL_STEP_S / moves.norm(dim=-1, keepdim=True).clamp(min=1e-6)).clamp(max=1.0)
    speed = rollout.speed.clamp(0.0, _FASTEST_MPS)
    return replace(rollout, xy=batch.pose[:, :, None, :2] + (share * moves).cumsum(2), speed=speed)


def _start(
    options: DiffusionOptions,
    view: View,
    noise: Mapping[str, FloatArray],
    shape: tuple[int, int],
    generator: torch.Generator,
) -> Tensor:
    """Return standard normal noise (samples, A, C, L); the first sample goes on from the last plan's."""
    fresh = draw(torch.zeros(options.samples, len(view.ids), *shape), generator)
    share = options.persistence
    for row, name in enumerate(view.ids):
        if name in noise:
            old = torch.from_numpy(noise[name]).to(fresh.dtype)
            fresh[0, row] = share * old.reshape(shape) + (1.0 - share**2) ** 0.5 * fresh[0, row]
    return fresh


def _shifts(
    guide: Guidance | None, view: View, attackers: tuple[str, ...], best: int
) -> dict[str, FloatArray]:
    if guide is None or guide.last_shift is None:
        return {}
    shift = guide.last_shift[best].cpu().numpy().astype(np.float64)
    return {name: shift[view.ids.index(name)] for name in attackers}


@torch.no_grad()
def most_plausible(rollout: Rollout, batch: SceneBatch, attackers: Sequence[int]) -> int:
    """Return the sample in which vehicles overlap each other and leave the road least.

    Args:
        rollout: samples (B, A, T) of one scene, the target first.
        batch: the scene, B times.
        attackers: rows of who is guided to the target; what they overlap it does not count.
    """
    overlap, rows = pair_overlap(rollout, batch.size, batch.present), list(attackers)
    overlap[:, 0, rows] = overlap[:, rows, 0] = 0.0
    touching = overlap.amax(dim=(2, 3)).sum(1)
    return int((touching + off_road(rollout, batch).amax(2).sum(1)).argmin())


def _only(rollout: Rollout, scene: int) -> Rollout:
    cut = slice(scene, scene + 1)
    return Rollout(
        rollout.xy[cut], rollout.yaw[cut], rollout.speed[cut], rollout.accel[cut], rollout.curvature[cut]
    )
