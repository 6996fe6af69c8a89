"""Reads and writes tensors or arrays with a JSON header in one safetensors file; nothing is unpickled."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.core.weights_formats import of_another_format
from advdiff_sumo.core.whole_file import whole_file

if TYPE_CHECKING:  # arrays can be stored without importing PyTorch
    from torch import Tensor, nn

_HEADER = "advdiff"


def write_stored(
    path: Path, values: Mapping[str, Tensor] | Mapping[str, NDArray[np.float64]], header: Mapping[str, Any]
) -> None:
    """Write *values* and *header* to *path*; the same contents give the same bytes."""
    arrays = {
        name: np.asarray(value if isinstance(value, np.ndarray) else value.detach().cpu().numpy(), order="C")
        for name, value in values.items()
    }
    with whole_file(path) as aside:
        # a single key: safetensors writes several keys in an order that varies from run to run
        # bytes: a file that safetensors makes itself, only its owner can read
        aside.write_bytes(save(arrays, metadata={_HEADER: json.dumps(dict(header), sort_keys=True)}))


def read_stored(
    path: Path, kind: str, missing: str, remedy: str, framework: Literal["pt", "np"] = "pt"
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return header and tensors of *path*, a file of :func:`write_stored`.

    Args:
        path: of the file.
        kind: the "format" that the header must name.
        missing: remedy if there is no such file.
        remedy: remedy if it cannot be used.
        framework: "pt": tensors; "np": NumPy arrays, without importing PyTorch.

    Raises:
        WeightsError: no such file, damaged, or of another format.
    """
    if not path.is_file():
        raise WeightsError(path, "no such file", missing)
    try:
        with safe_open(str(path), framework=framework) as file:
            header = _header(file.metadata() or {})
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dictionary
    except (SafetensorError, OSError) as error:
        raise WeightsError(path, f"cannot be read ({error})", remedy) from None
    if header.get("format") != kind:
        raise of_another_format(path, kind, str(header.get("format")), remedy)
    return header, tensors


def fill(
    network: nn.Module, tensors: Mapping[str, Tensor], path: Path, what: str, remedy: str = "train it again"
) -> None:
    """Load the *tensors* of *path* into *network*.

    Raises:
        WeightsError: they do not fit *what*.
    """
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        first = str(error).splitlines()[-1].strip()
        raise WeightsError(path, f"does not fit {what}: {first}", remedy) from None


def stored_options(header: Mapping[str, Any], path: Path, remedy: str) -> dict[str, Any]:
    """Return the options in the *header* of *path*.

    Raises:
        WeightsError: there are none.
    """
    options = header.get("options")
    if not isinstance(options, dict):
        raise WeightsError(path, "has no options in its header", remedy)
    return options


def with_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the *tensors* whose names begin with *prefix*, named without it."""
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def stored_format(path: Path) -> str:
    """Return the "format" in the header of *path*; "" if there is no such file or format."""
    try:
        with safe_open(str(path), framework="np") as file:
            return str(_header(file.metadata() or {}).get("format", ""))
    except (SafetensorError, OSError):
        return ""


def _header(metadata: Mapping[str, str]) -> dict[str, Any]:
    """Return the JSON object in *metadata*; {} if it is damaged or written by another program."""
    try:
        header = json.loads(metadata.get(_HEADER, "{}"))
    except ValueError:
        return {}
    return header if isinstance(header, dict) else {}
