"""Find the net on which each drive of a log was driven: given, that of a run, or converted from the log's map."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from advdiff_sumo.core.errors import AdvdiffError, InputError, LogError
from advdiff_sumo.core.whole_file import sha256_of
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

_NO_NET = "on none of the nets"


class NoNetError(AdvdiffError):
    """There is no net for a drive; the message gives the reason, as a clause."""


@dataclass(frozen=True)
class LogNets:
    """Nets to choose from, and the folder of converted ones.

    Attributes:
        given: by the user.
        converted: folder for nets converted from the logs' own maps; None: nothing is converted.
    """

    given: tuple[RoadMap, ...]
    converted: Path | None
    _roads: dict[Path, RoadMap] = field(default_factory=dict)
    _refused: dict[Path, str] = field(default_factory=dict)

    def of(self, drive: LogScene, reader: LogReader) -> RoadMap:
        """Return the net on which *drive* was driven; nets named after its map are tried first.

        Raises:
            NoNetError: the drive is on none of them, and its map cannot be converted or does not fit the drive.
        """
        for road in sorted(self.given, key=lambda road: road.name != drive.location):
            if fits(road, drive):
                return road
        if isinstance(reader, RunReader) and not self.given:
            return self._read(find_net(drive.location))
        if self.converted is None:
            raise NoNetError(_NO_NET)
        source = _map_of(drive, reader)
        if source not in self._roads:
            self._roads[source] = self._converted_road(source, self.converted)
        if not fits(self._roads[source], drive):
            raise NoNetError(f"the recording vehicle is off the lanes of its own map, {source.name}")
        return self._roads[source]

    def _read(self, net: Path) -> RoadMap:
        """Return the net in file *net*, which is read once."""
        if net not in self._roads:
            self._roads[net] = RoadMap.read(net)
        return self._roads[net]

    def _converted_road(self, source: Path, folder: Path) -> RoadMap:
        """Return the net converted from the map *source*; a failure is remembered."""
        if source in self._refused:
            raise NoNetError(self._refused[source])
        try:
            return RoadMap.read(_net_of(source, folder))
        except InputError as error:
            self._refused[source] = f"its map cannot be converted: {error}"
            raise NoNetError(self._refused[source]) from None


def _net_of(source: Path, folder: Path) -> Path:
    """Return the net in *folder* that was converted from *source*; convert it now if there is none.

    A net of the same name that was made from another map is kept; the new one then gets a number.
    """
    content = sha256_of(source)
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
    """Return the file with the map of *drive*.

    Raises:
        NoNetError: the file is missing, or the log has no map.
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
    raise NoNetError(_NO_NET)
