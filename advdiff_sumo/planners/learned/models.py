"""Sample joint futures from each of the three trained traffic models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError, WeightsError
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.whole_file import kept_while_same
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.fast_networks import fast_denoiser
from advdiff_sumo.diffusion.noise_schedule import NoiseSchedule
from advdiff_sumo.diffusion.sampler import Sampling, sample
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.gaussian import draw
from advdiff_sumo.models.shipped_weights import find_weights
from advdiff_sumo.models.simnet import SimNet, load_simnet
from advdiff_sumo.models.view import View
from advdiff_sumo.planners.learned.learned_options import (
    DiffusionPlannerOptions,
    SimNetPlannerOptions,
    TrafficSimPlannerOptions,
)


@dataclass(frozen=True)
class ModelFutures:
    """Futures that a model predicts.

    Attributes:
        rollout: S joint futures of the view's agents, as S scenes.
        noise: of the diffusion: id → starting noise, for each sample; empty for the other models.
    """

    rollout: Rollout
    noise: tuple[Mapping[str, FloatArray], ...] = field(default=())


class Model(Protocol):
    """A trained traffic model; it knows no route.

    Attributes:
        map_view: how much of the map it was trained with.
    """

    map_view: MapView

    def predict(
        self, view: View, noise: Mapping[str, FloatArray], generator: torch.Generator, steps: int
    ) -> ModelFutures:
        """Return joint futures of *steps* model steps; the diffusion starts from the last plan's *noise*."""
        ...


class SimNetModel:
    """SimNet: one future, without samples.

    Args:
        options: options of the target.
        device: device that it runs on.
    """

    def __init__(self, options: SimNetPlannerOptions, device: torch.device) -> None:
        self._device = device
        self._simnet = _simnet(str(find_weights(options.weights, "simnet")), device)
        self.map_view = self._simnet.options.map_view

    @torch.no_grad()
    def predict(
        self, view: View, noise: Mapping[str, FloatArray], generator: torch.Generator, steps: int
    ) -> ModelFutures:
        """Return the only future."""
        del noise, generator
        rollout: Rollout = self._simnet(view.batch.to(self._device), steps)
        return ModelFutures(rollout)


class TrafficSimModel:
    """The joint latent-variable model: the mean of its prior, and samples.

    Args:
        options: options of the target.
        device: device that it runs on.
    """

    def __init__(self, options: TrafficSimPlannerOptions, device: torch.device) -> None:
        self._device, self._draws = device, options.draws
        self._bundle, self._decoder = _bundle(str(find_weights(options.weights)), device)
        self.map_view = self._bundle.options.model.map_view

    @torch.no_grad()
    def predict(
        self, view: View, noise: Mapping[str, FloatArray], generator: torch.Generator, steps: int
    ) -> ModelFutures:
        """Return the future of the prior's mean, then those of the samples."""
        del noise
        batch = view.batch.to(self._device)
        context = self._bundle.traffic.encoder(batch)
        z = [context.prior.mean, *(context.prior.sample(generator) for _ in range(self._draws))]
        h = context.h.expand(len(z), -1, -1)
        return ModelFutures(self._decoder.whole(torch.cat(z), h, batch.repeat(len(z)), steps)[0])


class DiffusionModel:
    """Latent diffusion without a guide.

    Args:
        options: options of the target.
        device: device that it runs on.

    Raises:
        WeightsError: the bundle diffuses trajectories, not latents.
        ConfigError: more steps than the networks were trained with.
    """

    def __init__(self, options: DiffusionPlannerOptions, device: torch.device) -> None:
        path = str(find_weights(options.weights))
        self._options, self._device = options, device
        self._bundle, self._decoder = _bundle(path, device)
        self.map_view = self._bundle.options.model.map_view
        codec = self._bundle.codec
        if not isinstance(codec, LatentCodec):
            raise WeightsError(
                Path(path), "diffuses trajectories, not latents", "give weights of codec latent"
            )
        self._codec = codec
        self._schedule = NoiseSchedule(self._bundle.options.diffusion_steps, self._bundle.options.schedule)
        if options.steps > self._schedule.steps:
            raise ConfigError(
                f"options of target 'diffusion': steps = {options.steps}: "
                f"the networks were trained with {self._schedule.steps}; ask for at most so many"
            )
        self._sampling = Sampling(steps=options.steps, eta=0.0, begin=options.begin)
        self._denoiser = fast_denoiser(self._bundle.denoiser)

    @torch.no_grad()
    def predict(
        self, view: View, noise: Mapping[str, FloatArray], generator: torch.Generator, steps: int
    ) -> ModelFutures:
        """Return the futures of all samples; the first one starts from the last plan's noise."""
        options = self._options
        batch = view.batch.to(self._device)
        context = self._bundle.traffic.encoder(batch).repeat(options.samples)
        start = self._start(view, noise, generator)
        denoise = self._denoiser(context)
        x = sample(denoise, start.to(self._device), self._schedule, self._sampling, generator)
        z = self._codec.unscale(x)[:, :, 0]
        rollout = self._decoder.whole(z, context.h, batch.repeat(options.samples), steps)[0]
        start_noise = start[:, :, 0].numpy().astype(np.float64)
        return ModelFutures(rollout, tuple(dict(zip(view.ids, rows, strict=True)) for rows in start_noise))

    def _start(self, view: View, noise: Mapping[str, FloatArray], generator: torch.Generator) -> Tensor:
        """Return standard normal noise (S, A, 1, Z); in the first sample mixed with the last plan's *noise*."""
        latent, share = self._bundle.options.model.latent, self._options.persistence
        start = draw(torch.zeros(self._options.samples, len(view.ids), 1, latent), generator)
        for row, agent_id in enumerate(view.ids):
            if agent_id in noise:
                previous = torch.from_numpy(noise[agent_id]).to(start.dtype)
                start[0, row, 0] = share * previous + (1.0 - share**2) ** 0.5 * start[0, row, 0]
        return start


@kept_while_same(2)
def _simnet(path: str, device: torch.device) -> SimNet:
    return load_simnet(Path(path)).eval().requires_grad_(False).to(device)


@kept_while_same(2)
def _bundle(path: str, device: torch.device) -> tuple[Bundle, FastDecoder]:
    bundle = load_bundle(Path(path)).frozen().to(device)
    return bundle, FastDecoder(bundle.traffic.decoder)
