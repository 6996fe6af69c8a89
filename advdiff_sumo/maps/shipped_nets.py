"""Finds net files: shipped nets by name, others by path."""

from __future__ import annotations

from pathlib import Path

from advdiff_sumo.core.errors import FileError, NetError
from advdiff_sumo.maps.not_a_net import folder_error

SHIPPED_NETS = ("downtown", "downtown-left", "motorway")
"""Default nets of benches, training windows and sweeps."""
NETS_BY_NAME = (*SHIPPED_NETS, "downtown-people")
"""All shipped nets; ``downtown-people`` is ``downtown`` with crossings and sidewalks."""


def find_net(net: str) -> Path:
    """Return the file of a net that is given by path or by the name of a shipped net.

    Raises:
        NetError: there is no such file.
    """
    if net in NETS_BY_NAME:
        return shipped_networks() / f"{net}.net.xml"
    path = Path(net)
    if not path.exists():
        raise NetError(path, "no such net", f"give a .net.xml file or one of {', '.join(NETS_BY_NAME)}")
    if not path.is_file():
        raise folder_error(path)
    return path.resolve()


def net_name(net: str) -> str:
    """Return *net* as it is recorded: a shipped net by its name, any other one by its absolute path."""
    return net if net in NETS_BY_NAME else str(Path(net).resolve())


def shipped_networks() -> Path:
    """Return the folder of the shipped nets.

    Raises:
        FileError: the installation lacks them.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "networks", package.parent / "networks"):
        if (folder / "downtown.net.xml").is_file():
            return folder
    raise FileError(package / "networks", "the shipped nets are missing", "install the package again")
