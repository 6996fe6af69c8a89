"""Reward models on their own, as warm-up against one target leaves them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.reward import RewardModel
from advdiff_sumo.models.stored import read_stored, write_stored

FORMAT = "advdiff-reward-1"


def save_reward(reward: RewardModel, path: Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write Q's tensors alone to *path*, a ".safetensors" file; *extra* goes into its header as JSON."""
    write_stored(path, reward.state_dict(), {"format": FORMAT, "extra": dict(extra or {})})


def load_reward(path: Path, bundle: Bundle) -> RewardModel:
    """Read what :func:`save_reward` wrote, for the networks of *bundle*.

    Raises:
        WeightsError: no such file, another format, or a reward model of other sizes than the bundle's.
    """
    _, tensors = read_stored(
        path, FORMAT, "make it with advdiff-sumo warmup", "give a file that advdiff-sumo warmup made"
    )
    with torch.random.fork_rng(devices=[]):
        reward = RewardModel(bundle.options.model)
    try:
        reward.load_state_dict(tensors)
    except RuntimeError as error:
        first = str(error).splitlines()[-1].strip()
        raise WeightsError(
            path, f"does not fit the networks: {first}", "warm up with the weights that the run uses"
        ) from None
    return reward
