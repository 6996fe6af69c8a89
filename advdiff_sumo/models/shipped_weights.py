"""Where the shipped networks lie, and on which device they run."""

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
        name: "traffic": the bundle of all traffic models; "closed-loop": the same with a decoder that closes the loop
            and sees the map as far as is driven; SimNet, or traj2traj; "failures": what is
            believed of any planner's failures in lawful encounters.
    """
    return Path(str(files("advdiff_sumo"))) / "weights" / f"{name}.safetensors"


def find_weights(given: str, default: ShippedName = "traffic") -> Path:
    """Return the file that is *given*: itself, a training's folder, a shipped one by name, or by "" the *default*."""
    path = Path(given)
    if given and (path / WEIGHTS).is_file():
        return path / WEIGHTS
    if given in get_args(ShippedName) and not path.exists():
        default, given = cast("ShippedName", given), ""
    return path if given else shipped_weights(default)


def device_of(name: str, whose: str) -> torch.device:
    """Return the device that a user's *name* stands for; "auto" is a GPU where there is one.

    Raises:
        ConfigError: PyTorch has no such device here; it says *whose* option it is.
    """
    import torch  # late: who asks where a file lies does not need it

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
