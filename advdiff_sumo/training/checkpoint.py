"""Checkpoints of a training: one safetensors file with tensors, and JSON in its header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as tensor_bytes
from torch import Tensor

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.core.whole_file import whole_file

FORMAT = "advdiff-training-1"
NAME = "checkpoint.safetensors"
_HEADER = "advdiff"


@dataclass
class TrainingProgress:
    """Progress of a training.

    Attributes:
        stage: name of the stage.
        options: all hyper-parameters, as plain values.
        data: hash of the training data and of the initial weights.
        seed: of the random numbers; None in checkpoints of earlier versions.
        epoch: finished epochs.
        batch: finished batches of the current epoch.
        step: finished steps of the optimiser.
        sums: sums of the loss terms over the current epoch, with their weights.
        best: best value of the monitored figure so far.
        best_epoch: epoch in which it was reached.
        history: one record for each finished epoch.
        done: whether the training has ended (all epochs, or stopped early).
    """

    stage: str
    options: dict[str, Any]
    data: str
    seed: int | None = None
    epoch: int = 0
    batch: int = 0
    step: int = 0
    sums: dict[str, tuple[float, float]] = field(default_factory=dict)
    best: float | None = None
    best_epoch: int = 0
    history: list[dict[str, Any]] = field(default_factory=list)
    done: bool = False


def save(folder: Path, progress: TrainingProgress, groups: Mapping[str, Mapping[str, Tensor]]) -> None:
    """Write the checkpoint atomically: if the process is killed, the old or the new one is complete.

    Raises:
        WeightsError: the folder cannot be written.
    """
    tensors = {
        f"{group}/{name}": value.detach().contiguous().cpu().clone()
        for group, named in groups.items()
        for name, value in named.items()
    }
    header = {"format": FORMAT, "progress": vars(progress)}
    try:
        with whole_file(folder / NAME) as aside:
            # a single key: safetensors writes several keys in an order that varies from run to run
            # bytes: a file that safetensors makes itself, only its owner can read
            aside.write_bytes(tensor_bytes(tensors, metadata={_HEADER: json.dumps(header, sort_keys=True)}))
    except (OSError, SafetensorError) as error:
        raise WeightsError(folder / NAME, f"cannot be written ({error})") from None


def load(folder: Path) -> tuple[TrainingProgress, dict[str, dict[str, Tensor]]]:
    """Read a checkpoint.

    Returns:
        The progress of the training, and its tensors by group and name, on the CPU.

    Raises:
        WeightsError: there is none, or it is damaged or of another format.
    """
    path = folder / NAME
    if not path.is_file():
        raise WeightsError(path, "no such checkpoint", "start the training without --resume")
    groups: dict[str, dict[str, Tensor]] = {}
    try:
        with safe_open(path, framework="pt") as stored:
            header = json.loads((stored.metadata() or {}).get(_HEADER, "{}"))
            if header.get("format") != FORMAT:
                raise WeightsError(path, "is no checkpoint of a training", "name the --out of a training")
            for key in stored.keys():  # noqa: SIM118 - safetensors' handle is no mapping
                group, _, name = key.partition("/")
                groups.setdefault(group, {})[name] = stored.get_tensor(key)
            progress = TrainingProgress(**header["progress"])
    except (SafetensorError, OSError, ValueError, TypeError, KeyError) as error:
        raise WeightsError(path, f"cannot be read ({error})", "start the training afresh") from None
    progress.sums = {name: (value, weight) for name, (value, weight) in progress.sums.items()}
    elbo = progress.options.get("elbo", {})
    if elbo.get("prior_weight") == 0.0:  # an option of earlier versions, without effect at 0
        del elbo["prior_weight"]
    return progress, groups


def optimiser_tensors(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Return the state tensors of the optimiser, named "parameter number.moment"."""
    state: dict[int, dict[str, Tensor]] = optimiser.state_dict()["state"]
    return {f"{number}.{name}": value for number, moments in state.items() for name, value in moments.items()}


def restore_optimiser(optimiser: torch.optim.Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """Restore the state of an optimiser from :func:`optimiser_tensors`."""
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        number, _, name = key.partition(".")
        state.setdefault(int(number), {})[name] = value
    optimiser.load_state_dict({**optimiser.state_dict(), "state": state})
