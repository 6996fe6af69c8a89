"""Reward models on their own, as warm-up against one target leaves them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.bundle import Bundle
from advdiff_sumo.models.reward import RewardModel

FORMAT = "advdiff-reward-1"
_HEADER = "advdiff"


def save_reward(reward: RewardModel, path: Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write Q's tensors alone to *path*, a ".safetensors" file; *extra* goes into its header as JSON."""
    header = {"format": FORMAT, "extra": dict(extra or {})}
    tensors = {name: value.detach().cpu().contiguous() for name, value in reward.state_dict().items()}
    aside = path.with_suffix(".tmp")
    save_file(tensors, str(aside), metadata={_HEADER: json.dumps(header, sort_keys=True)})
    aside.replace(path)


def load_reward(path: Path, bundle: Bundle) -> RewardModel:
    """Read what :func:`save_reward` wrote, for the networks of *bundle*.

    Raises:
        WeightsError: no such file, another format, or a reward model of other sizes than the bundle's.
    """
    if not path.is_file():
        raise WeightsError(path, "no such file", "make it with advdiff-sumo warmup")
    try:
        with safe_open(str(path), framework="pt") as file:
            header = json.loads((file.metadata() or {}).get(_HEADER, "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dictionary
    except (SafetensorError, OSError) as error:
        raise WeightsError(
            path, f"cannot be read ({error})", "give a file that advdiff-sumo warmup made"
        ) from None
    if header.get("format") != FORMAT:
        raise WeightsError(
            path, f"is not of the format {FORMAT}", "give a file that advdiff-sumo warmup made"
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
