"""The net that each drive of a log was driven on: a given one, that of a run, or one converted from the log's map."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from advdiff_sumo.core.errors import AdvdiffError, InputError, LogError
from advdiff_sumo.data import (
    Argoverse2Reader,
    CommonRoadReader,
    LogReader,
    LogScene,
    NuScenesReader,
    ScenarioNetReader,
)
from advdiff_sumo.data.runs import RunReader
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.not_a_net import map_name
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.sim.logs import fits
from advdiff_sumo.sim.source_maps import read_source

_NOT_ON = "on none of the nets"


class NoNetError(AdvdiffError):
    """There is no net for a drive; the message says why, as a clause."""


@dataclass(frozen=True)
class LogNets:
    """Nets to choose from, and where converted ones are kept.

    Attributes:
        given: by the user.
        converted: folder for nets converted from the logs' own maps; None: nothing is converted.
    """

    given: tuple[RoadMap, ...]
    converted: Path | None
    _roads: dict[Path, RoadMap] = field(default_factory=dict)
    _refused: dict[Path, str] = field(default_factory=dict)

    def of(self, drive: LogScene, reader: LogReader) -> RoadMap:
        """Return the net that *drive* was driven on, those called like its map first.

        Raises:
            NoNetError: none of them is, and its map cannot be converted, or gives no net that it is on.
        """
        for road in sorted(self.given, key=lambda road: road.name != drive.location):
            if fits(road, drive):
                return road
        if isinstance(reader, RunReader) and not self.given:
            return self._read(find_net(reader.net))
        if self.converted is None:
            raise NoNetError(_NOT_ON)
        source = _map_of(drive, reader)
        if source not in self._roads:
            self._roads[source] = self._converted(source, self.converted)
        if not fits(self._roads[source], drive):
            raise NoNetError(f"the recording vehicle is off the lanes of its own map, {source.name}")
        return self._roads[source]

    def _read(self, net: Path) -> RoadMap:
        if net not in self._roads:
            self._roads[net] = RoadMap.read(net)
        return self._roads[net]

    def _converted(self, source: Path, folder: Path) -> RoadMap:
        """Return the net made of *source*, which is kept; another one of its name is left as it is."""
        if source in self._refused:
            raise NoNetError(self._refused[source])
        try:
            return RoadMap.read(_net_of(source, folder))
        except InputError as error:
            self._refused[source] = f"its map cannot be converted: {error}"
            raise NoNetError(self._refused[source]) from None


def _net_of(source: Path, folder: Path) -> Path:
    """Return the net in *folder* that was made of *source*; made now where there is none."""
    content = hashlib.sha256(source.read_bytes()).hexdigest()
    for number in count(1):
        name = map_name(source) + (f"-{number}" if number > 1 else "")
        net, made_of = folder / f"{name}.net.xml", folder / f"{name}.source"
        if not net.exists():
            convert_source(read_source(source), net)
            made_of.write_text(f"{content}  {source.name}\n", encoding="utf-8")
            return net
        if made_of.is_file() and made_of.read_text(encoding="utf-8").startswith(content):
            return net
    raise AssertionError  # count has no end


def _map_of(drive: LogScene, reader: LogReader) -> Path:
    """Return the file that holds the map of *drive*.

    Raises:
        NoNetError: it is not there, or the log brings no map.
    """
    if isinstance(reader, ScenarioNetReader | CommonRoadReader):
        return drive.source
    if isinstance(reader, NuScenesReader):
        path = reader.folder.parent / "maps" / "expansion" / f"{drive.location}.json"
        if not path.exists():
            raise NoNetError(f"{path}: no such map; unpack the map expansion v1.3 there, or give a --net")
        return path
    if isinstance(reader, Argoverse2Reader):
        try:
            return reader.map_file(drive.name)
        except LogError as error:
            raise NoNetError(str(error)) from None
    raise NoNetError(_NOT_ON)
