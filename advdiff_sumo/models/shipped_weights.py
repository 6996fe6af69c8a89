"""Paths of the shipped networks, and the device they run on."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, cast, get_args

from advdiff_sumo.core.errors import ConfigError

if TYPE_CHECKING:
    import torch

#: File in the folder of a training that holds its networks.
WEIGHTS = "weights.safetensors"
ShippedName: TypeAlias = Literal["traffic", "closed-loop", "simnet", "traj2traj", "failures"]


def shipped_weights(name: ShippedName = "traffic") -> Path:
    """Return the path of shipped networks.

    Args:
        name: "traffic": networks of the paper's architecture; "closed-loop": with closed-loop decoder and far map view;
            "simnet"; "traj2traj"; "failures": the prior of ``models.failure_predictor``.
    """
    return Path(str(files("advdiff_sumo"))) / "weights" / f"{name}.safetensors"


def find_weights(name_or_path: str, default: ShippedName = "traffic") -> Path:
    """Return the weights file *name_or_path* as a path, a training's folder or a shipped name; "": the *default*."""
    path = Path(name_or_path)
    if name_or_path and (path / WEIGHTS).is_file():
        return path / WEIGHTS
    if name_or_path in get_args(ShippedName) and not path.exists():
        default, name_or_path = cast("ShippedName", name_or_path), ""
    return path if name_or_path else shipped_weights(default)


def device_of(name: str, whose: str) -> torch.device:
    """Return the device that a user named; "auto" is a GPU if there is one.

    Raises:
        ConfigError: PyTorch cannot use such a device; the message names *whose* option it is.
    """
    import torch  # late: finding a file does not need it

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(
            f"options of {whose}: device = '{name}' cannot be used ({reason}); "
            "leave it at auto, or name cpu or cuda"
        ) from None
    return device
