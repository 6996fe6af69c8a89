"""Loads the trained networks and prepares them for planning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor

from advdiff_sumo.core.errors import ConfigError, WeightsError
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.core.whole_file import file_state
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.diffusion.fast_networks import fast_denoiser, fast_reward
from advdiff_sumo.diffusion.guides import Sloped
from advdiff_sumo.diffusion.noise_schedule import NoiseSchedule
from advdiff_sumo.diffusion.sampler import Noise, Sampling
from advdiff_sumo.models.bundle import Bundle, load_bundle
from advdiff_sumo.models.codec import LatentCodec, TrajectoryCodec
from advdiff_sumo.models.context import Context
from advdiff_sumo.models.reward import RewardModel, RewardState, load_reward
from advdiff_sumo.models.shipped_weights import device_of
from advdiff_sumo.traffic.diffusion.diffusion_options import DiffusionOptions
from advdiff_sumo.traffic.planning.pace import faster_latent


@dataclass(frozen=True)
class Networks:
    """Networks of one bundle on one device.

    Attributes:
        bundle: all networks, frozen.
        codec: converts between latents and what is diffused.
        denoiser: the denoiser, optimised for planning.
        decoder: the decoder, for whole scenes and for some of their rows.
        reward: the reward model Q, optimised for planning.
        schedule: noise schedule with which the denoiser was trained.
        sampling: how plans are sampled.
        faster: (C, L) direction of scaled latents in which vehicles drive faster; see ``planning.pace``.
        device: device of the networks.
    """

    bundle: Bundle
    codec: LatentCodec | TrajectoryCodec
    denoiser: Callable[[Context], Noise]
    decoder: FastDecoder
    reward: Callable[[RewardState], Sloped]
    schedule: NoiseSchedule
    sampling: Sampling
    faster: Tensor
    device: torch.device

    def guided_by(self, reward: RewardModel) -> Networks:
        """Return the same networks with *reward* in its present state; call again after training it further."""
        return replace(self, bundle=replace(self.bundle, reward=reward), reward=fast_reward(reward))


@one_thread()
def networks_of(options: DiffusionOptions) -> Networks:
    """Return the networks that *options* name; files are read once a process, and again if they change.

    Raises:
        WeightsError: a file is missing, damaged, or holds networks that this policy cannot use.
        ConfigError: no such device, or more steps than the networks were trained with.
    """
    device = device_of(options.device, "background 'diffusion'")
    sampling = Sampling(options.steps, options.family, options.eta, options.begin)
    states = tuple(file_state(file) for file in (options.path, options.q_file) if file)
    networks = _networks(states, str(options.path), options.q_file, device, sampling)
    if options.guided and not isinstance(networks.codec, LatentCodec):
        raise WeightsError(
            options.path,
            "diffuses trajectories, which nothing guides",
            "give weights of codec latent, or --guide none",
        )
    trained = networks.bundle.stages
    if options.guided and not options.q_file and trained and "reward" not in trained:
        raise WeightsError(
            options.path,
            "has no trained reward model, which guides",
            "train its stage 'reward', name one with --reward, or give --guide none",
        )
    return networks


@lru_cache(maxsize=2)
def _networks(
    _states: tuple[tuple[int, int], ...], path: str, reward: str, device: torch.device, sampling: Sampling
) -> Networks:
    _raise_allocation_threshold()
    bundle = load_bundle(Path(path))
    if reward:
        bundle = replace(bundle, reward=load_reward(Path(reward), bundle.options.model))
    schedule = NoiseSchedule(bundle.options.diffusion_steps, bundle.options.schedule)
    if sampling.steps > schedule.steps:
        raise ConfigError(
            f"options of background 'diffusion': steps = {sampling.steps}: "
            f"the networks were trained with {schedule.steps}; ask for at most so many"
        )
    bundle = bundle.frozen()
    faster = faster_latent(bundle).to(device)
    bundle = bundle.to(device)
    return Networks(
        bundle=bundle,
        codec=bundle.codec,
        denoiser=fast_denoiser(bundle.denoiser),
        decoder=FastDecoder(bundle.traffic.decoder),
        reward=fast_reward(bundle.reward),
        schedule=schedule,
        sampling=sampling,
        faster=faster,
        device=device,
    )


def _raise_allocation_threshold() -> None:
    """Free a block of 30 MB once, after which glibc keeps blocks up to that size instead of returning them.

    A plan of 24 vehicles takes 1 to 2 ms less, as the system need not clear new pages.
    """
    torch.empty(30_000_000, dtype=torch.uint8)
