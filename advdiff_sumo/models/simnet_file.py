"""SimNet's weights in a file of their own, and its beginning from a traffic model's encoder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.bundle import FORMAT as BUNDLE_FORMAT
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.simnet import SimNet
from advdiff_sumo.models.stored import read_stored, stored_format, write_stored

FORMAT = "advdiff-simnet-1"
_AGAIN = "train it again with this version: advdiff-sumo train simnet"
_ENCODER = "traffic.encoder."


def new_simnet(options: ModelOptions, seed: int = 0) -> SimNet:
    """Return an untrained network; the same seed gives the same weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return SimNet(options)


def save_simnet(simnet: SimNet, path: Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write *simnet* to *path*, a ".safetensors" file; *extra* goes into its header as JSON."""
    header = {
        "format": FORMAT,
        "options": simnet.options.model_dump(mode="json"),
        "extra": dict(extra or {}),
    }
    write_stored(path, simnet.state_dict(), header)


def load_simnet(path: Path) -> SimNet:
    """Read what :func:`save_simnet` wrote.

    Raises:
        WeightsError: no such file, another format, or tensors that do not fit the options in its header.
    """
    missing = "make it with advdiff-sumo train simnet, and name it by the option weights"
    header, tensors = read_stored(path, FORMAT, missing, _AGAIN)
    simnet = new_simnet(_options(header.get("options"), path))
    _fill(simnet, tensors, path)
    return simnet


def begin_simnet(init: Path | None, options: ModelOptions, seed: int = 0) -> SimNet:
    """Return the network that a training begins with.

    Args:
        init: a file of :func:`save_simnet`, or a traffic bundle, of which the context encoder is taken; None: all new.
        options: sizes where there is no *init*.
        seed: of new weights.

    Raises:
        WeightsError: *init* cannot be used.
    """
    if init is None:
        return new_simnet(options, seed)
    return load_simnet(init) if stored_format(init) == FORMAT else _on_encoder(init, seed)


def _on_encoder(path: Path, seed: int) -> SimNet:
    """Return a network with the context encoder of the traffic bundle at *path* and a new head.

    Raises:
        WeightsError: no such file, no bundle, or one whose encoder does not fit its options.
    """
    again = "train it again with this version"
    header, tensors = read_stored(path, BUNDLE_FORMAT, "name weights of the stage traffic with --init", again)
    options = header.get("options")
    simnet = new_simnet(_options(options.get("model") if isinstance(options, dict) else None, path), seed)
    own = {n.removeprefix(_ENCODER): t for n, t in tensors.items() if n.startswith(_ENCODER)}
    head = {f"head.{name}": value for name, value in simnet.head.state_dict().items()}
    _fill(simnet, {**{f"encoder.{name}": value for name, value in own.items()}, **head}, path)
    return simnet


def _options(header: object, path: Path) -> ModelOptions:
    if not isinstance(header, dict):
        raise WeightsError(path, "has no options in its header", _AGAIN)
    return ModelOptions.parse(header, f"{path}: its options")


def _fill(simnet: SimNet, tensors: Mapping[str, Tensor], path: Path) -> None:
    try:
        simnet.load_state_dict(tensors)
    except RuntimeError as error:
        first = str(error).splitlines()[-1].strip()
        raise WeightsError(path, f"does not fit its own options: {first}", "train it again") from None
