"""Checkpoints: safetensors with the networks' options in the header, and a card beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.codec import CodecName, LatentCodec, TrajectoryCodec, make_codec
from advdiff_sumo.models.denoiser import Denoiser
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.reward import RewardModel
from advdiff_sumo.models.stored import read_stored, write_stored
from advdiff_sumo.models.traffic import TrafficModel

FORMAT = "advdiff-weights-1"


class BundleOptions(Options):
    """What is needed to make the networks again.

    Attributes:
        model: sizes.
        codec: what the denoiser works on.
        diffusion_steps: K of the noise schedule.
        schedule: its kind.
    """

    model: ModelOptions = ModelOptions()
    codec: CodecName = "latent"
    diffusion_steps: int = 100
    schedule: Literal["cosine", "linear"] = "cosine"


@dataclass(frozen=True)
class Bundle:
    """All networks of one traffic model.

    Attributes:
        options: how they were made.
        traffic: encoder, posterior and decoder.
        codec: with its scale.
        denoiser: noise prediction.
        reward: Q.
        stages: names of the stages that have been trained, in order.
    """

    options: BundleOptions
    traffic: TrafficModel
    codec: LatentCodec | TrajectoryCodec
    denoiser: Denoiser
    reward: RewardModel
    stages: tuple[str, ...] = ()

    def modules(self) -> dict[str, nn.Module]:
        """Return the networks by the prefix of their tensors."""
        return {
            "traffic": self.traffic,
            "codec": self.codec,
            "denoiser": self.denoiser,
            "reward": self.reward,
        }

    def tensors(self) -> dict[str, Tensor]:
        """Return every weight and statistic by name."""
        return {
            f"{prefix}.{name}": value
            for prefix, module in self.modules().items()
            for name, value in module.state_dict().items()
        }

    def to(self, device: torch.device | str) -> Bundle:
        """Move the networks to *device* and return the bundle."""
        for module in self.modules().values():
            module.to(device)
        return self

    def frozen(self) -> Bundle:
        """Switch training off, gradients of weights too, and return the bundle."""
        for module in self.modules().values():
            module.eval().requires_grad_(False)
        return self


def new_bundle(options: BundleOptions, seed: int = 0) -> Bundle:
    """Return untrained networks; the same seed gives the same weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        traffic = TrafficModel(options.model)
        codec = make_codec(options.codec, options.model, traffic)
        denoiser = Denoiser(options.model, codec.shape)
        reward = RewardModel(options.model)
    return Bundle(options, traffic, codec, denoiser, reward)


def save_bundle(
    bundle: Bundle, path: Path, stages: tuple[str, ...], extra: Mapping[str, Any] | None = None
) -> None:
    """Write *path*, aside first and then renamed.

    Args:
        bundle: networks.
        path: a ".safetensors" file.
        stages: names of the stages trained so far.
        extra: what else the header shall carry, plain JSON.
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
    again = "train it again with this version"
    header, tensors = read_stored(
        path, FORMAT, "train it, or leave the option out for the shipped weights", again
    )
    if not isinstance(header.get("options"), dict):
        raise WeightsError(path, "has no options in its header", again)
    options = BundleOptions.parse(header["options"], f"{path}: its options")
    bundle = new_bundle(options)
    _fill(bundle, tensors, path)
    return Bundle(
        options,
        bundle.traffic,
        bundle.codec,
        bundle.denoiser,
        bundle.reward,
        tuple(header.get("stages", ())),
    )


def halve_bundle(source: Path, path: Path) -> None:
    """Write the bundle *source* to *path* with numbers of 16 bits, which are read as 32 bits again: half the size.

    Raises:
        WeightsError: *source* cannot be read.
    """
    header, tensors = read_stored(source, FORMAT, "train it", "train it again with this version")
    write_stored(path, {name: value.half() for name, value in tensors.items()}, header)


def _fill(bundle: Bundle, tensors: Mapping[str, Tensor], path: Path) -> None:
    for prefix, module in bundle.modules().items():
        own = {
            name.removeprefix(f"{prefix}."): t for name, t in tensors.items() if name.startswith(f"{prefix}.")
        }
        try:
            module.load_state_dict(own)
        except RuntimeError as error:
            first = str(error).splitlines()[-1].strip()
            raise WeightsError(path, f"does not fit its own options: {first}", "train it again") from None
