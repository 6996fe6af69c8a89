"""Loads the traffic model in which the baselines search."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.core.map_view import MapView
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.core.whole_file import kept_while_same
from advdiff_sumo.models.bundle import load_bundle
from advdiff_sumo.models.codec import LatentCodec
from advdiff_sumo.models.shipped_weights import device_of, find_weights
from advdiff_sumo.models.traffic import TrafficModel
from advdiff_sumo.traffic.baselines.baseline_options import BaselineOptions


@dataclass(frozen=True)
class FrozenPrior:
    """The TrafficSim part of a bundle, frozen: encoder with its prior, and decoder.

    Attributes:
        traffic: the networks.
        codec: converts between latents and scaled latents.
        device: device of the networks.
    """

    traffic: TrafficModel
    codec: LatentCodec
    device: torch.device

    @property
    def map_view(self) -> MapView:
        """The view of the map with which the networks were trained."""
        return self.traffic.decoder.options.map_view


@one_thread()
def prior_of(options: BaselineOptions, owner: str) -> FrozenPrior:
    """Return the networks that *options* name; files are read once a process.

    Args:
        options: options of the baseline.
        owner: name of the baseline in error messages.

    Raises:
        WeightsError: the file is missing, damaged, or holds no latent model.
        ConfigError: no such device.
    """
    device = device_of(options.device, owner)
    return _prior(str(find_weights(options.weights)), device)


@kept_while_same(2)
def _prior(path: str, device: torch.device) -> FrozenPrior:
    bundle = load_bundle(Path(path))
    if not isinstance(bundle.codec, LatentCodec):
        raise WeightsError(Path(path), "diffuses trajectories, not latents", "give weights of codec latent")
    bundle = bundle.frozen().to(device)
    assert isinstance(bundle.codec, LatentCodec)  # noqa: S101 - checked above, for the type checker
    return FrozenPrior(bundle.traffic, bundle.codec, device)
