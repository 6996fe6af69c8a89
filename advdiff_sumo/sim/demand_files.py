"""Find the demand files that a user gives: one route file, or those that a SUMO configuration names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand_check import first_departure_s
from advdiff_sumo.sim.demand_xml import check_whole, elements, seconds

_OUTPUT_TAGS = {
    "e1Detector",
    "inductionLoop",
    "e2Detector",
    "laneAreaDetector",
    "e3Detector",
    "entryExitDetector",
}
_OUTPUT_TAGS |= {"instantInductionLoop", "edgeData", "laneData", "routeProbe", "timedEvent"}
"""Elements that make SUMO write files."""


@dataclass(frozen=True)
class DemandFiles:
    """Files from which SUMO makes traffic.

    Attributes:
        routes: route files.
        additional: vehicle types, signals and stops that they need.
        begin_s: when the simulation begins: the whole second of the first departure.
        ignored: additional files with detectors and outputs only, which SUMO does not get.
    """

    routes: tuple[Path, ...]
    additional: tuple[Path, ...]
    begin_s: float
    ignored: tuple[Path, ...] = ()

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that SUMO gets, route files first."""
        return (*self.routes, *self.additional)


@dataclass(frozen=True)
class _NamedFiles:
    """The files that a configuration names, and when the simulation begins by it."""

    routes: tuple[Path, ...]
    additional: tuple[Path, ...] = ()
    begin_s: float = 0.0


def read_demand(path: Path, road: RoadMap) -> DemandFiles:
    """Find the files behind *path* and check that they belong to *road*.

    Args:
        path: ``.rou.xml``, ``.trips.xml`` (each gzipped or not) or ``.sumocfg``.
        road: the net on which they will run.

    Raises:
        FileError: a file is missing, truncated, or no demand.
        SceneError: the routes belong to another net.
    """
    _must_be_file(path, "give a .rou.xml, .trips.xml or .sumocfg")
    named = _read_configuration(path) if path.suffix == ".sumocfg" else _NamedFiles((path,))
    for file in (*named.routes, *named.additional):
        check_whole(file)
    kept = tuple(file for file in named.additional if not _has_only_outputs(file))
    ignored = tuple(file for file in named.additional if file not in kept)
    begin = first_departure_s(path, (*kept, *named.routes), road, named.begin_s)
    return DemandFiles(
        tuple(f.resolve() for f in named.routes), tuple(f.resolve() for f in kept), begin, ignored
    )


def net_of_configuration(path: Path) -> Path:
    """Return the net that a SUMO configuration names.

    Raises:
        FileError: it is missing, truncated, or names none.
    """
    _must_be_file(path, "give a .net.xml or a .sumocfg")
    for element in elements(path):
        if element.tag == "net-file" and element.get("value"):
            net = path.parent / element.get("value", "")
            _must_be_file(net, _name_remedy(path), "net")
            return net
    raise FileError(path, "names no net-file", "give the .net.xml and the demand one by one")


def _read_configuration(path: Path) -> _NamedFiles:
    """Return what the SUMO configuration *path* names."""
    files: dict[str, tuple[Path, ...]] = {}
    begin = 0.0
    for element in elements(path):
        if element.tag in {"route-files", "additional-files"}:
            file_names = element.get("value", "").replace(",", " ").split()
            files[element.tag] = tuple(path.parent / file for file in file_names)
        elif element.tag == "begin":
            begin = seconds(element.get("value", "")) or 0.0
    if not any(files.values()):
        raise FileError(path, "names no route-files", "give a .rou.xml or a configuration that has them")
    for file in (file for file_names in files.values() for file in file_names):
        _must_be_file(file, _name_remedy(path))
    return _NamedFiles(files.get("route-files", ()), files.get("additional-files", ()), max(begin, 0.0))


def _name_remedy(configuration: Path) -> str:
    """Return the remedy for a missing file that *configuration* names."""
    return f"{configuration.name} names it: put it there or correct the name"


def _must_be_file(path: Path, remedy: str, what: str = "demand file") -> None:
    """Raise FileError with *remedy* if *path* is not a file."""
    if not path.is_file():
        raise FileError(path, "is no file" if path.exists() else f"no such {what}", remedy)


def _has_only_outputs(path: Path) -> bool:
    """Return whether *path* contains only detectors and outputs, which would write files beside it."""
    tags = {element.tag for element in elements(path)} - {
        "additional",
        "add",
        "param",
        "detEntry",
        "detExit",
    }
    return bool(tags) and tags <= _OUTPUT_TAGS
