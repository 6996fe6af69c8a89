"""The actor, which maps a vehicle's features to its deviation from the behaviour model, and its file format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.stored import fill, read_stored, write_stored
from advdiff_sumo.traffic.rl.features import FEATURES
from advdiff_sumo.traffic.rl.prior import PriorName

FORMAT = "advdiff-actor-1"
ACTIONS = 2
"""Numbers of an action: deviations of acceleration and curvature."""
_REMEDY = "train it again with this version: advdiff-sumo train-rl"


class ActorNet(nn.Module):
    """An MLP with tanh between its layers; the mean of PPO's Gaussian policy.

    Args:
        hidden: widths of the hidden layers.
        features: number of features of an observation.
    """

    def __init__(self, hidden: Sequence[int], features: int = FEATURES) -> None:
        super().__init__()
        widths = (features, *hidden)
        layers: list[nn.Module] = []
        for width_in, width_out in pairwise(widths):
            layers += [nn.Linear(width_in, width_out), nn.Tanh()]
        self.body = nn.Sequential(*layers)
        self.head = nn.Linear(widths[-1], ACTIONS)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, observation: Tensor) -> Tensor:
        """Return the unbounded mean actions (…, 2) for observations (…, F)."""
        mean: Tensor = self.head(self.body(observation))
        return mean


@dataclass(frozen=True)
class Actor:
    """A trained actor.

    Attributes:
        net: the network; a new one returns zero, so that the vehicle drives as the behaviour model.
        hidden: widths of its hidden layers.
        prior: the behaviour model from which it was trained to deviate.
        notes: further entries of its file.
    """

    net: ActorNet
    hidden: tuple[int, ...]
    prior: PriorName
    notes: Mapping[str, Any] = field(default_factory=dict)

    def residuals(self, observations: FloatArray) -> FloatArray:
        """Return deviations (R, 2) in [−1, 1] for observations (R, F)."""
        with torch.no_grad():
            means = self.net(torch.from_numpy(observations.astype(np.float32)))
        return np.asarray(means.clamp(-1.0, 1.0).numpy(), dtype=np.float64)


def save_actor(actor: Actor, path: Path) -> None:
    """Write *actor* to *path*, a ".safetensors" file."""
    header = {
        "format": FORMAT,
        "hidden": list(actor.hidden),
        "features": FEATURES,
        "prior": actor.prior,
        "notes": dict(actor.notes),
    }
    write_stored(path, actor.net.state_dict(), header)


def load_actor(path: Path) -> Actor:
    """Read a file of :func:`save_actor`; requires only PyTorch.

    Raises:
        WeightsError: no such file, another format, or tensors that do not fit its header.
    """
    missing = "train it with advdiff-sumo train-rl, or leave the option out for the shipped actor"
    header, tensors = read_stored(path, FORMAT, missing, _REMEDY)
    hidden, features, prior = header.get("hidden"), header.get("features"), header.get("prior")
    if not isinstance(hidden, list) or prior not in ("simnet", "traffic"):
        raise WeightsError(path, "has no usable header", _REMEDY)
    if features != FEATURES:
        raise WeightsError(path, f"observes {features} features, this version {FEATURES}", _REMEDY)
    net = ActorNet(hidden)
    fill(net, tensors, path, "its own header", _REMEDY)
    if not all(bool(torch.isfinite(weight).all()) for weight in net.parameters()):
        raise WeightsError(path, "holds weights that are not numbers", _REMEDY)
    return Actor(net.eval().requires_grad_(False), tuple(hidden), prior, header.get("notes", {}))
