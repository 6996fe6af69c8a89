"""Demand that the user brings: a route file, or a SUMO configuration that names several."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand_check import first_departure_s
from advdiff_sumo.sim.demand_xml import check_whole, elements, seconds

_WRITES_OUTPUT = {
    "e1Detector",
    "inductionLoop",
    "e2Detector",
    "laneAreaDetector",
    "e3Detector",
    "entryExitDetector",
}
_WRITES_OUTPUT |= {"instantInductionLoop", "edgeData", "laneData", "routeProbe", "timedEvent"}


@dataclass(frozen=True)
class DemandFiles:
    """Files that SUMO reads to make traffic.

    Attributes:
        routes: route files.
        additional: vehicle types, signals and stops that they need.
        begin_s: when the simulation begins: the whole second of the first departure.
        ignored: additional files that hold nothing but detectors and outputs, which SUMO is not given.
    """

    routes: tuple[Path, ...]
    additional: tuple[Path, ...]
    begin_s: float
    ignored: tuple[Path, ...] = ()

    @property
    def files(self) -> tuple[Path, ...]:
        """All that SUMO is given, route files first."""
        return (*self.routes, *self.additional)


@dataclass(frozen=True)
class _Named:
    """What a configuration names, and when it lets the simulation begin."""

    routes: tuple[Path, ...]
    additional: tuple[Path, ...] = ()
    begin_s: float = 0.0


def read_demand(path: Path, road: RoadMap) -> DemandFiles:
    """Find the files behind *path* and check that they belong to *road*.

    Args:
        path: ``.rou.xml``, ``.trips.xml`` (each gzipped or not) or ``.sumocfg``.
        road: the net that they will run on.

    Raises:
        FileError: a file is missing, truncated, or no demand.
        SceneError: the routes are of another net.
    """
    _must_be_file(path, "give a .rou.xml, .trips.xml or .sumocfg")
    named = _of_configuration(path) if path.suffix == ".sumocfg" else _Named((path,))
    for file in (*named.routes, *named.additional):
        check_whole(file)
    kept = tuple(file for file in named.additional if not _only_output(file))
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
            _must_be_file(net, _correct(path), "net")
            return net
    raise FileError(path, "names no net-file", "give the .net.xml and the demand one by one")


def _of_configuration(path: Path) -> _Named:
    files: dict[str, tuple[Path, ...]] = {}
    begin = 0.0
    for element in elements(path):
        if element.tag in {"route-files", "additional-files"}:
            names = element.get("value", "").replace(",", " ").split()
            files[element.tag] = tuple(path.parent / name for name in names)
        elif element.tag == "begin":
            begin = seconds(element.get("value", "")) or 0.0
    if not any(files.values()):
        raise FileError(path, "names no route-files", "give a .rou.xml or a configuration that has them")
    for name in (name for names in files.values() for name in names):
        _must_be_file(name, _correct(path))
    return _Named(files.get("route-files", ()), files.get("additional-files", ()), max(begin, 0.0))


def _correct(configuration: Path) -> str:
    return f"{configuration.name} names it: put it there or correct the name"


def _must_be_file(path: Path, remedy: str, what: str = "demand file") -> None:
    if not path.is_file():
        raise FileError(path, "is no file" if path.exists() else f"no such {what}", remedy)


def _only_output(path: Path) -> bool:
    """Return whether *path* holds detectors only, which would write files beside it."""
    tags = {element.tag for element in elements(path)} - {
        "additional",
        "add",
        "param",
        "detEntry",
        "detExit",
    }
    return bool(tags) and tags <= _WRITES_OUTPUT
