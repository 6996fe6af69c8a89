"""Finds and reads the nets of a run or sweep when they are first drawn."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from advdiff_sumo.core.distinct_names import distinct_names
from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import NETS_BY_NAME, find_net
from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.layer import MapLayer


class NetLayers:
    """Layers by the name of the net in the episodes' rows, and ``problems`` of nets that cannot be drawn."""

    def __init__(self, run: FinishedRun) -> None:
        self._folder = run.folder
        self._layers: dict[str, MapLayer | None] = {}
        self.problems: dict[str, str] = {}

    def layer(self, name: str) -> MapLayer | None:
        """Return the layer of the net *name*; None if it cannot be drawn, for the reason in ``problems``."""
        if name not in self._layers:
            self._layers[name] = self._read(name)
        return self._layers[name]

    def _read(self, name: str) -> MapLayer | None:
        if name in ("", "?"):
            self.problems[name] = "run.toml names no net"
            return None
        path = net_path(name, self._folder)
        if path is None:
            self.problems[name] = f"the net {name} is no longer there"
            return None
        try:
            return MapLayer(RoadMap.read(path))
        except NetError as error:
            self.problems[name] = str(error)
            return None


def net_path(name: str, folder: Path) -> Path | None:
    """Return the file of the net *name*: as named, in *folder*, or a shipped one; None if there is none."""
    shipped = (find_net(name),) if name in NETS_BY_NAME else ()
    return next((p for p in (Path(name), folder / Path(name).name, *shipped) if p.is_file()), None)


def place_name(net: str) -> str:
    """Return a net's name for display, without folder and suffixes."""
    return Path(net).name.removesuffix(".gz").removesuffix(".xml").removesuffix(".net")


def place_names(nets: Iterable[str]) -> dict[str, str]:
    """Return net → its name for display; equal names are distinguished by their folders."""
    nets = list(nets)
    names = distinct_names({Path(net): place_name(net) for net in nets})
    return {net: names[Path(net)] for net in nets}
