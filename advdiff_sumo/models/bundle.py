"""Checkpoints of a traffic model: safetensors files with the networks' options in the header."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from advdiff_sumo.config import Options
from advdiff_sumo.models.codec import CodecName, LatentCodec, TrajectoryCodec
from advdiff_sumo.models.denoiser import Denoiser
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.reward import RewardModel
from advdiff_sumo.models.stored import fill, read_stored, stored_options, with_prefix, write_stored
from advdiff_sumo.models.traffic import TrafficModel

FORMAT = "advdiff-weights-1"
AGAIN = "train it again with this version"


class BundleOptions(Options):
    """Options from which the networks can be constructed.

    Attributes:
        model: sizes of the networks.
        codec: whether latents or trajectories are diffused.
        diffusion_steps: K of the noise schedule.
        schedule: kind of the noise schedule.
    """

    model: ModelOptions = ModelOptions()
    codec: CodecName = "latent"
    diffusion_steps: int = 100
    schedule: Literal["cosine", "linear"] = "cosine"


@dataclass(frozen=True)
class Bundle:
    """All networks of one traffic model.

    Attributes:
        options: from which they were constructed.
        traffic: encoder, posterior and decoder.
        codec: conversion to what is diffused, with its scale.
        denoiser: noise prediction.
        reward: Q.
        stages: names of the training stages completed, in order.
    """

    options: BundleOptions
    traffic: TrafficModel
    codec: LatentCodec | TrajectoryCodec
    denoiser: Denoiser
    reward: RewardModel
    stages: tuple[str, ...] = ()

    def modules(self) -> nn.ModuleDict:
        """Return the networks, named by the prefix of their tensors."""
        names = ("traffic", "codec", "denoiser", "reward")
        return nn.ModuleDict({name: getattr(self, name) for name in names})

    def tensors(self) -> dict[str, Tensor]:
        """Return every weight and statistic by name."""
        return dict(self.modules().state_dict())

    def to(self, device: torch.device | str) -> Bundle:
        """Move the networks to *device* and return the bundle."""
        self.modules().to(device)
        return self

    def frozen(self) -> Bundle:
        """Switch to evaluation mode without gradients of weights, and return the bundle."""
        self.modules().eval().requires_grad_(False)
        return self


def new_bundle(options: BundleOptions, seed: int = 0) -> Bundle:
    """Return untrained networks; the same seed gives the same weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        traffic = TrafficModel(options.model)
        codec = LatentCodec(options.model, traffic) if options.codec == "latent" else TrajectoryCodec()
        denoiser = Denoiser(options.model, codec.shape)
        reward = RewardModel(options.model)
    return Bundle(options, traffic, codec, denoiser, reward)


def save_bundle(
    bundle: Bundle, path: Path, stages: tuple[str, ...], extra: Mapping[str, Any] | None = None
) -> None:
    """Write *bundle* to *path*, a ".safetensors" file, which is complete or not there at all.

    *stages* are those trained so far; *extra* is added to the header as JSON.
    """
    header = {
        "format": FORMAT,
        "options": bundle.options.model_dump(mode="json"),
        "stages": list(stages),
        "extra": dict(extra or {}),
    }
    write_stored(path, bundle.tensors(), header)


def load_bundle(path: Path) -> Bundle:
    """Read what :func:`save_bundle` wrote.

    Raises:
        WeightsError: no such file, another format, or tensors that do not fit the options in its header.
    """
    missing = "train it, or name shipped weights: traffic or closed-loop"
    header, tensors = read_stored(path, FORMAT, missing, AGAIN)
    bundle = new_bundle(BundleOptions.parse(stored_options(header, path, AGAIN), f"{path}: its options"))
    for name, network in bundle.modules().items():
        fill(network, with_prefix(tensors, f"{name}."), path, "its own options")
    return replace(bundle, stages=tuple(header.get("stages", ())))


def halve_bundle(source: Path, path: Path) -> None:
    """Write the bundle *source* to *path* in half precision, half the size; loading converts it to 32 bits again.

    Raises:
        WeightsError: *source* cannot be read.
    """
    header, tensors = read_stored(source, FORMAT, "train it", AGAIN)
    write_stored(path, {name: value.half() for name, value in tensors.items()}, header)
