"""The behaviour model that moves all vehicles, and from which attackers deviate."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Literal, Protocol, TypeAlias

import torch

from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.diffusion.fast_decoder import FastDecoder
from advdiff_sumo.models.batch import SceneBatch
from advdiff_sumo.models.bundle import load_bundle
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.shipped_weights import find_weights
from advdiff_sumo.models.simnet import load_simnet

PriorName: TypeAlias = Literal["simnet", "traffic"]
PLAN_STEPS = 8
"""Model steps of a plan: one is driven, the safeguard checks six, and the choice of attackers uses all."""


class Prior(Protocol):
    """A model of the natural futures of all road users.

    Attributes:
        options: options of the model, with the bounds of its actions.
    """

    options: ModelOptions

    def rollout(self, batch: SceneBatch) -> Rollout:
        """Return the futures (B, A, ``PLAN_STEPS``) of all agents; deterministic."""
        ...


class SimNetPrior:
    """SimNet, a behaviour-cloning model that predicts step by step (the paper's choice)."""

    def __init__(self, path: Path) -> None:
        self._net = load_simnet(path).eval().requires_grad_(False)
        self.options = self._net.options

    def rollout(self, batch: SceneBatch) -> Rollout:
        """Return the futures that SimNet predicts."""
        with torch.no_grad():
            futures: Rollout = self._net(batch, PLAN_STEPS)
        return futures


class TrafficPrior:
    """The traffic model's decoder at the mean of its prior over latents."""

    def __init__(self, path: Path) -> None:
        bundle = load_bundle(path).frozen()
        self._encoder, self._decoder = bundle.traffic.encoder, FastDecoder(bundle.traffic.decoder)
        self.options = bundle.options.model

    def rollout(self, batch: SceneBatch) -> Rollout:
        """Return the most likely futures of the traffic model."""
        with torch.no_grad():
            context = self._encoder(batch)
        return self._decoder.whole(context.prior.mean, context.h, batch, PLAN_STEPS)[0]


@lru_cache(maxsize=4)
@one_thread()
def load_prior(name: PriorName, weights: str = "") -> Prior:
    """Return the behaviour model *name* from the file *weights*, or the shipped ones if empty; read once a process.

    Raises:
        WeightsError: the file is missing or unusable.
    """
    kinds: dict[PriorName, type[SimNetPrior | TrafficPrior]] = {
        "simnet": SimNetPrior,
        "traffic": TrafficPrior,
    }
    return kinds[name](find_weights(weights, name))
